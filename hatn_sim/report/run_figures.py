"""The figures there are of a run's log, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from hatn_sim.errors import InputError
from hatn_sim.log import Run
from hatn_sim.report.picture import UNFINISHED


@dataclass(frozen=True)
class Wish:
    """What to look at; None: what tells the most."""

    time_s: float | None = None
    ego_id: str | None = None


Draw = Callable[[Run, Wish, Sequence[Path]], None]


def where(run: Run) -> str:
    """What a run is of, in a few words."""
    words = str(run.header.get("title") or run.header.get("scene") or run.path.name)
    seed = run.header.get("seed")
    words = words if seed is None else f"{words}, seed {seed}"
    words = words if run.signals_known else f"{words}, signals unknown"
    return words if run.finished else f"{words}, {UNFINISHED}"


def _moment(run: Run, wish: Wish, paths: Sequence[Path]) -> None:
    from hatn_sim.report.picture import choose_moment, draw_moment

    draw_moment(run, *choose_moment(run, wish.time_s, wish.ego_id), paths)


def _space_time(run: Run, wish: Wish, paths: Sequence[Path]) -> None:
    from hatn_sim.report.choice import choose_moment
    from hatn_sim.report.space_time import space_time
    from hatn_sim.report.space_time_figure import draw_space_time

    story = space_time(run, *choose_moment(run, wish.time_s, wish.ego_id))
    draw_space_time(story, where(run), paths)


def _traffic(run: Run, _: Wish, paths: Sequence[Path]) -> None:
    from hatn_sim.report.traffic_figure import draw_traffic
    from hatn_sim.score.close_passes import shown_passes
    from hatn_sim.score.driven import driven_in
    from hatn_sim.score.events import severe_events
    from hatn_sim.score.logged import alerts_in

    if not len(run.ids):
        raise InputError(f"{run.path}: no vehicles in this run, nothing to draw")
    driven = driven_in(run)
    events = [*severe_events(driven), *shown_passes(driven)]
    draw_traffic(run, alerts_in(run), events, where(run), paths)


def _calibration(run: Run, _: Wish, paths: Sequence[Path]) -> None:
    from hatn_sim.report.calibration_figure import draw_calibration
    from hatn_sim.score.slot_calibration import slot_reliability

    found = slot_reliability(run)
    if not found:
        raise InputError(
            f"{run.path}: nobody of this run had slots to choose from whose outcome is known; make "
            "a longer run with --predictor hatn"
        )
    draw_calibration(found, where(run), paths)


def _errors(run: Run, _: Wish, paths: Sequence[Path]) -> None:
    from hatn_sim.report.steps_figure import draw_steps
    from hatn_sim.score.steps import errors_by_step

    errors = [
        replace(one, trained=_is_first(run, one.predictor) and one.scene in run.trained_on)
        for one in errors_by_step([run])
        if one.subset == "moving"
    ]
    if not errors:
        raise InputError(
            f"{run.path}: no moving vehicle was predicted and then seen for 3 s; make a longer run"
        )
    note = "" if run.finished else UNFINISHED
    draw_steps(errors, paths, note=note, unknown=_of_unknown_training(run))


def _of_unknown_training(run: Run) -> list[str]:
    """The predictors with weights of which a run does not say what these learnt from."""
    with_weights = run.header.get("weights_sha256", {})
    return [
        name
        for name in run.predictors
        if name.removesuffix("+route") in with_weights
        and not (_is_first(run, name) and run.trained_on)
    ]


def _is_first(run: Run, reported: str) -> bool:
    """Whether it is the predictor that a run knows the training scenes of; +route is no other."""
    return reported.removesuffix("+route") == run.predictors[0].removesuffix("+route")


RUN_FIGURES: Final[Mapping[str, Draw]] = {
    "moment": _moment,
    "spacetime": _space_time,
    "traffic": _traffic,
    "calibration": _calibration,
    "errors": _errors,
}
"""Each raises InputError where the run lacks what it takes."""
OF_A_MOMENT: Final = ("moment", "spacetime")
"""Those that follow a wish."""
