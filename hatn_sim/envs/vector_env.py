"""Several environments of one scene as one: everybody in all of them is predicted in one batch."""

from __future__ import annotations

from functools import partial
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import iterate

from hatn_sim.envs.errors import ActionError, ActionShapeError, ActionTypeError, OptionError
from hatn_sim.envs.mind import BatchPredictor, predictor_of
from hatn_sim.envs.options import EnvOptions
from hatn_sim.envs.scene_env import SceneEnv
from hatn_sim.envs.turns import Turn, taken


class SceneVectorEnv(SyncVectorEnv):
    """`SceneEnv`s side by side, each with a simulator of its own; as gymnasium's `SyncVectorEnv`.

    Made by `gymnasium.make_vec("hatn_sim/Scene-v0", num_envs=8, scene=..., ...)` with the options
    of `SceneEnv`, and `autoreset_mode` as gymnasium has it. The simulators drive at the same time,
    and the predictor is asked once for all of them, if it can be (`mind.BatchPredictor`). What
    comes of it is what the environments give one by one, but for rounding in the networks (1e-5).

    Where an action of one is refused, nothing has happened in any. Where one fails, all have to be
    reset.
    """

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        if num_envs < 1:
            raise OptionError(f"num_envs: expected 1 or more, found {num_envs}; correct it")
        predictor = predictor_of(options.get("predictor", EnvOptions.predictor))
        make = partial(SceneEnv, **options | {"predictor": predictor})
        super().__init__([lambda: _Ahead(make())] * num_envs, autoreset_mode=autoreset_mode)
        if isinstance(predictor, BatchPredictor):
            scene_envs = [env.scene_env for env in cast(list[_Ahead], self.envs)]
            for env in scene_envs:
                env.share_road(scene_envs)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """As of `SyncVectorEnv`. Raises as `SceneEnv.step` does."""
        each = self._each(actions)
        begins = self._autoreset_envs & (self.autoreset_mode == AutoresetMode.NEXT_STEP)
        ahead = cast(list[_Ahead], self.envs)
        results = taken(
            [
                env.scene_env.opening() if is_over else _numbered(k, env.scene_env.turn(action))
                for k, (env, is_over, action) in enumerate(
                    zip(ahead, begins.tolist(), each, strict=True)
                )
            ]
        )
        for env, result in zip(ahead, results, strict=True):
            env.result = result
        try:
            return super().step(actions)
        finally:
            for env in ahead:  # ctrl-C may have come between
                env.result = None

    def _each(self, actions: Any) -> list[Any]:
        """The action of every environment. Raises ActionError where there is not one of each."""
        try:
            each = list(iterate(self.action_space, actions))
        except (TypeError, ValueError, gymnasium.error.CustomSpaceError):
            raise ActionTypeError(
                f"actions: expected one of each environment, found {actions!r}; give an array"
            ) from None
        if len(each) != self.num_envs:
            raise ActionShapeError(
                f"actions: expected one of each of {self.num_envs} environments, found {len(each)}"
            )
        return each

    def action_masks(self) -> np.ndarray:
        """The slots [num_envs, M] that may be chosen now."""
        return np.stack([env.scene_env.action_masks() for env in cast(list[_Ahead], self.envs)])


def _numbered(number: int, turn: Turn[Any]) -> Turn[Any]:
    """A turn that says whose action was refused."""
    try:
        return (yield from turn)
    except ActionError as error:
        raise type(error)(f"environment {number}: {error}") from None


class _Ahead(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Gives the result of the turn that was taken already, if one was."""

    def __init__(self, env: SceneEnv) -> None:
        super().__init__(env)
        self.scene_env = env
        self.result: Any = None

    def step(self, action: Any) -> Any:
        result, self.result = self.result, None
        return self.env.step(action) if result is None else result

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        result, self.result = self.result, None
        return self.env.reset(seed=seed, options=options) if result is None else result
