"""The fit loop on problems whose answers are known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from test_whole_file import little_room
from torch import Tensor, nn

from hatn_sim.datatypes import IntArray
from hatn_sim.errors import InputError
from hatn_sim.learn.fit import Figures, FitSettings, LossError, Workplace, fit
from hatn_sim.learn.watch import Nobody

SLOPES = torch.tensor([[1.5, -0.5, 0.25]])
RANDOM = np.random.default_rng(3)
X = torch.from_numpy(RANDOM.standard_normal((400, 3)).astype(np.float32))
SAMPLES = range(len(X))
QUICK = FitSettings(epochs=6, batch=32, learning_rate=0.05, weight_decay=0.0, average=0.9)


class Told(Nobody):
    """Notes the lines, and does something at a step."""

    def __init__(self, at: Callable[[int], object] = lambda _: None) -> None:
        self.lines: list[str] = []
        self._at = at

    def step(self, stage: str, done: int, total: int, words: str) -> None:
        self._at(done)

    def say(self, line: str) -> None:
        self.lines.append(line)


def network() -> nn.Sequential:
    torch.manual_seed(0)
    return nn.Sequential(nn.Dropout(0.1), nn.Linear(3, 1, bias=False))


def fitted(
    place: Workplace, settings: FitSettings = QUICK, spoil: Callable[[int], float] = lambda _: 1.0
) -> tuple[nn.Sequential, Figures]:
    """Slopes learnt from samples without noise; `spoil` multiplies the loss of the n-th step."""
    model = network()
    steps = 0

    def loss_of(_: object, rows: IntArray) -> Tensor:
        nonlocal steps
        steps += 1
        x = X[torch.from_numpy(rows)]
        return ((model(x) - x @ SLOPES.T) ** 2).mean() * spoil(steps)

    def figures() -> Figures:
        return {"error": float((model[1].weight - SLOPES).abs().max())}

    return model, fit(
        model, SAMPLES, loss_of, figures, "error", name="LINE", settings=settings, place=place
    )


def weights_of(model: nn.Sequential) -> Tensor:
    return model[1].weight.detach().clone()


def test_known_slopes_are_found_and_the_best_weights_kept() -> None:
    watch = Told()
    model, figures = fitted(Workplace(watch=watch))
    assert figures["error"] < 0.1
    assert float((weights_of(model) - SLOPES).abs().max()) == pytest.approx(figures["error"])
    assert not model.training
    assert len(watch.lines) == 6 and watch.lines[0].startswith("LINE epoch 1 of 6: loss ")


def test_it_repeats_itself_and_another_seed_does_not() -> None:
    first, again, other = (fitted(Workplace(seed=seed))[0] for seed in (1, 1, 2))
    assert torch.equal(weights_of(first), weights_of(again))
    assert not torch.equal(weights_of(first), weights_of(other))


@pytest.mark.parametrize("stop_at", [1, 13, 14, 40, 78])
def test_who_was_killed_ends_with_the_same_weights_bit_for_bit(
    tmp_path: Path, stop_at: int
) -> None:
    """78 steps in 6 epochs; killed in the first one, between two, later, and at the last step."""
    whole, figures = fitted(Workplace())

    def kill(step: int) -> None:
        if step == stop_at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fitted(Workplace(progress=tmp_path, watch=Told(kill)))
    torch.manual_seed(99)  # whatever the new process begins with
    steps: list[int] = []
    model, resumed = fitted(Workplace(progress=tmp_path, watch=Told(steps.append)))
    assert torch.equal(weights_of(model), weights_of(whole)) and resumed == figures
    assert steps == list(range((stop_at - 1) // 13 * 13 + 1, 79))
    # And once more, when all is done.
    steps.clear()
    model, resumed = fitted(Workplace(progress=tmp_path, watch=Told(steps.append)))
    assert torch.equal(weights_of(model), weights_of(whole)) and steps == []


def test_who_diverges_goes_on_from_the_best_weights_and_slower(tmp_path: Path) -> None:
    """In the seventh epoch the loss is turned around: steps lead away from the slopes."""
    settings = FitSettings(**{**vars(QUICK), "epochs": 12})

    def turned(step: int) -> float:
        return -100.0 if 78 < step <= 91 else 1.0

    watch = Told()
    model, _ = fitted(Workplace(watch=watch), settings, turned)
    (line,) = [line for line in watch.lines if "diverged" in line]  # once, and not again
    assert line.startswith("LINE diverged in epoch 7 (error ")
    assert line.endswith("back to the weights of epoch 5, at 0.5 of the learning rate")

    def kill(step: int) -> None:
        if step == 100:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fitted(Workplace(progress=tmp_path, watch=Told(kill)), settings, turned)
    resumed, _ = fitted(Workplace(progress=tmp_path), settings)  # goes on after the seventh
    assert torch.equal(weights_of(resumed), weights_of(model))


def test_a_lost_loss_says_where_and_leaves_the_last_good_weights(tmp_path: Path) -> None:
    good, _ = fitted(Workplace(), FitSettings(**{**vars(QUICK), "patience": 100}))
    with pytest.raises(LossError) as lost:
        fitted(Workplace(progress=tmp_path), spoil=lambda n: np.nan if n == 30 else 1.0)
    assert str(lost.value) == (
        "training LINE: the loss became nan at step 30, in epoch 3: train with a smaller "
        f"learning_rate; the weights of epoch {lost.value.epoch} are kept"
    )
    assert lost.value.epoch in (1, 2)
    assert isinstance(lost.value.model, nn.Sequential)
    kept = weights_of(lost.value.model)
    assert torch.isfinite(kept).all() and not torch.equal(kept, weights_of(good))
    assert float((kept - SLOPES).abs().max()) == pytest.approx(lost.value.figures["error"])
    with pytest.raises(LossError, match=r"at step 2, in epoch 1: .*; none are good"):
        fitted(Workplace(), spoil=lambda n: np.inf if n == 2 else 1.0)


def test_figures_that_are_never_finite_are_a_lost_loss() -> None:
    model = network()
    with pytest.raises(LossError, match=r"^training LINE: error was never finite: train with a "):
        fit(
            model,
            SAMPLES,
            lambda *_: (model[1].weight ** 2).sum(),
            lambda: {"error": float("nan")},
            "error",
            name="LINE",
            settings=QUICK,
            place=Workplace(),
        )


def test_it_ends_early_where_nothing_gets_better() -> None:
    """The figures of a network that learns nothing are the same after every epoch."""
    watch = Told()
    settings = FitSettings(epochs=50, patience=3, batch=32, weight_decay=0.0)
    fitted(Workplace(watch=watch), settings, spoil=lambda _: 0.0)
    assert len(watch.lines) == 1 + 3


def test_a_full_disk_is_one_line_and_nothing_is_lost(tmp_path: Path) -> None:
    whole, _ = fitted(Workplace())

    def stop(step: int) -> None:
        if step == 30:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fitted(Workplace(progress=tmp_path, watch=Told(stop)))
    kept = (tmp_path / "line.pt").read_bytes()
    with little_room(1000), pytest.raises(InputError) as full:
        fitted(Workplace(progress=tmp_path))
    assert str(full.value).startswith(f"{tmp_path / 'line.pt'}: cannot be written: ")
    assert str(full.value).endswith(
        "; make room and give the same command again, which goes on with epoch 3"
    )
    assert "\n" not in str(full.value)
    assert [path.name for path in tmp_path.iterdir()] == ["line.pt"]
    assert (tmp_path / "line.pt").read_bytes() == kept
    model, _ = fitted(Workplace(progress=tmp_path))
    assert torch.equal(weights_of(model), weights_of(whole))


def test_a_damaged_checkpoint_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "line.pt").write_bytes(b"PK\x03\x04 no checkpoint")
    with pytest.raises(InputError, match=r"line\.pt: not a checkpoint of this training"):
        fitted(Workplace(progress=tmp_path))
