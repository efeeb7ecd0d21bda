"""Train a policy that drives: PPO or DQN on the environments, until the time is up.

Writes FOLDER/ALGORITHM.safetensors with a card that says how it was made, and progress.jsonl with
its picture: how long crossing took, and how often it ended in a collision, over the last 50
episodes, in which the policy tried things out. To drive it,
write a module of your own (see agents/ppo.py) and name it: hatn-sim run --agent module:Class. Needs
stable-baselines3: pip install 'hatn-sim[rl]'.
"""

from __future__ import annotations

import argparse
import shlex
from dataclasses import asdict
from functools import partial
from importlib.util import find_spec
from itertools import cycle, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import hatn_sim
from hatn_sim.commands.options import names, part, seconds, whole_number
from hatn_sim.errors import HatnSimError

if TYPE_CHECKING:
    from hatn_sim.datatypes import Agent
    from hatn_sim.policies.training import Progress

EXAMPLES = """examples:
  hatn-sim train-policy --out my_policy
  hatn-sim train-policy --algorithm dqn --scenes roundabout8 --minutes 30 --out my_dqn
  hatn-sim train-policy --predictor hatn --see-predictions --out my_foresight
"""
SCENES: Final = ("intersection5", "roundabout8")
ENVS: Final = 8
TOLD_SHARE: Final = 0.6
MINUTES: Final = 40.0
MOST_STEPS: Final = 250_000
ALGORITHMS: Final = ("ppo", "dqn")


class InterruptedTrainingError(HatnSimError):
    """By ctrl-C."""

    exit_code = 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim train-policy`."""
    parser.add_argument("--algorithm", choices=ALGORITHMS, default="ppo")
    parser.add_argument(
        "--scenes",
        type=names,
        default=SCENES,
        metavar="A,B",
        help=f"the environments are of these by turns (default: {','.join(SCENES)})",
    )
    parser.add_argument(
        "--envs",
        type=whole_number,
        default=ENVS,
        metavar="N",
        help=f"environments side by side, a process each (default: {ENVS})",
    )
    parser.add_argument(
        "--minutes", type=seconds, default=MINUTES, metavar="M", help=f"(default: {MINUTES:g})"
    )
    parser.add_argument(
        "--steps",
        type=whole_number,
        default=MOST_STEPS,
        metavar="N",
        help=f"stop after so many decisions of half a second, too (default: {MOST_STEPS:,})",
    )
    parser.add_argument(
        "--told-share",
        type=part,
        default=TOLD_SHARE,
        metavar="SHARE",
        help="of the training, at its beginning, in which everybody's route is told, which is "
        f"faster than to infer it (default: {TOLD_SHARE:g})",
    )
    parser.add_argument("--density", metavar="light|normal|dense")
    parser.add_argument("--risk", metavar="NAME", help="of the other drivers")
    parser.add_argument(
        "--predictor",
        default="constant_velocity",
        metavar="NAME",
        help="whose graphs and predictions are observed (default: constant_velocity)",
    )
    parser.add_argument(
        "--see-predictions",
        action="store_true",
        help="let the policy read predicted paths and slot probabilities, not the moment alone",
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="of traffic and networks (default: 1)"
    )
    parser.add_argument(
        "--mark",
        type=mark,
        action="append",
        default=[],
        metavar="AGENT[=S]",
        help="the time of another driver, to be drawn into the picture: so many seconds, or what "
        "the agent of that name takes in this traffic; may be repeated",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def mark(text: str) -> tuple[str, float | None]:
    """A driver's name and its seconds, as `idm=30.6`, or None: to be found out."""
    name, is_known, number = text.partition("=")
    if not name:
        raise argparse.ArgumentTypeError(f"expected AGENT or NAME=SECONDS, found {text!r}")
    return name, seconds(number) if is_known else None


def main(arguments: argparse.Namespace) -> int:
    """Train, write, say how it went."""
    from hatn_sim.errors import InputError
    from hatn_sim.plugins import load_agent

    out: Path = arguments.out
    if find_spec("stable_baselines3") is None:
        raise InputError(
            "train-policy: expected stable-baselines3, found none; pip install 'hatn-sim[rl]'"
        )
    if not arguments.scenes:
        raise InputError("--scenes: expected names, found none; name some as A,B")
    if out.exists():
        raise InputError(f"{out}: exists already; expected a new folder: choose another --out")
    if not 0 <= arguments.seed < 2**31:
        raise InputError(f"--seed {arguments.seed}: expected 0 to {2**31 - 1}")
    agents = {name: load_agent(name) for name, time_s in arguments.mark if time_s is None}
    rows = _train(arguments, out / f"{arguments.algorithm}.safetensors")
    if not rows:
        print(
            f"{out}: stopped before ten episodes were over: weights, but no progress to be drawn; "
            "give it more --minutes or --steps, and another --out"
        )
        return 0
    marks_s = _marks_s(arguments, agents)
    _draw(arguments, rows, marks_s)
    beside = "".join(f"; {name} takes {marks_s[name]:.1f} s" for name in agents)
    last = rows[-1]
    print(
        f"{out}: {last.episodes:,} episodes, {last.steps:,} decisions in {last.minutes:.0f} min; "
        f"over the last ones {last.time_s:.1f} s to cross, {last.arrived:.0%} arrived, "
        f"{last.collided:.0%} collided{beside}"
    )
    return 0


def _train(arguments: argparse.Namespace, path: Path) -> list[Progress]:
    from hatn_sim.commands.train_progress import TrainProgress
    from hatn_sim.policies.inputs import Layout
    from hatn_sim.policies.lawful_env import make_lawful
    from hatn_sim.policies.training import (
        Pace,
        learn,
        make_learner,
        side_by_side,
        write_policy,
        write_progress,
    )

    layout = Layout(arguments.see_predictions)
    traffic = {key: getattr(arguments, key) for key in ("density", "risk")}
    lines = "route" if arguments.told_share else "inferred"
    makers = [
        partial(make_lawful, scene, arguments.predictor, layout, lines=lines, **traffic)
        for scene in arguments.scenes
    ]
    for make in makers:  # what is wrong with one is told here
        make().close()
    together = list(islice(cycle(makers), arguments.envs))
    rows: list[Progress] = []
    with side_by_side(together) as envs, TrainProgress(arguments.quiet) as watch:
        learner = make_learner(arguments.algorithm, envs, layout, arguments.seed)

        def tell(row: Progress) -> None:
            rows.append(row)
            words = f"{row.time_s:.1f} s to cross, {row.collided:.0%} collided"
            watch.step("decisions", row.steps, arguments.steps, words)
            write_progress(path.parent / "progress.jsonl", rows)

        def keep() -> None:
            card = _card(arguments, rows) | {"decisions": learner.num_timesteps}
            write_policy(path, learner, layout, card)

        pace = Pace(arguments.minutes, arguments.steps, arguments.told_share)
        try:
            learn(learner, pace, tell, keep)
        except KeyboardInterrupt:
            keep()
            raise InterruptedTrainingError(
                f"interrupted; what was learnt in {learner.num_timesteps:,} decisions is in "
                f"{path.parent}. A training cannot be gone on with: begin anew with another --out"
            ) from None
    return rows


def _marks_s(arguments: argparse.Namespace, agents: dict[str, Agent]) -> dict[str, float]:
    """The times to be drawn, those of `agents` found out by driving."""
    from hatn_sim.commands.train_progress import TrainProgress
    from hatn_sim.policies.beside import mean_time_s

    traffic = {key: getattr(arguments, key) for key in ("density", "risk")}
    marks_s = {name: time_s for name, time_s in arguments.mark if time_s is not None}
    with TrainProgress(arguments.quiet) as watch:
        for name, agent in agents.items():
            tell = partial(watch.step, f"episodes of {name}", words="")
            marks_s[name] = mean_time_s(
                agent, arguments.scenes, arguments.predictor, tell, **traffic
            )
    return marks_s


def _draw(arguments: argparse.Namespace, rows: list[Progress], marks_s: dict[str, float]) -> None:
    import numpy as np

    from hatn_sim.report.policy_figure import draw_learning

    draw_learning(
        f"{arguments.algorithm.upper()} learns to cross {' and '.join(arguments.scenes)}",
        np.array([row.steps / 1000.0 for row in rows]),
        np.array([row.time_s for row in rows]),
        np.array([row.collided for row in rows]),
        marks_s,
        arguments.out / "progress.png",
    )


def _card(arguments: argparse.Namespace, rows: list[Progress]) -> dict[str, Any]:
    """How the policy was made; the command that makes it again, but for how fast a machine is."""
    words = ["hatn-sim", "train-policy"]
    for name, value in vars(arguments).items():
        if name in ("verb", "quiet", "mark") or value is None or value is False:
            continue
        option = f"--{name.replace('_', '-')}"
        if value is True:
            words.append(option)
        else:
            told = value.name if isinstance(value, Path) else value
            words += [option, ",".join(told) if isinstance(told, tuple) else f"{told}"]
    return {
        "command": shlex.join(words),
        "hatn_sim": hatn_sim.__version__,
        "while_exploring": asdict(rows[-1]) if rows else None,
    }
