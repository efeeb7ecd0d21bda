"""What `hatn-sim run` tells and leaves of a finished run, besides its log."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from hatn_sim.commands.rate_text import rate_text
from hatn_sim.datatypes import DT_S, Score

if TYPE_CHECKING:
    from hatn_sim.commands.run_simulated import Simulated
    from hatn_sim.log import Run
    from hatn_sim.simulators.sumo_replay.figures import Divergence, Fidelity

REPLAY_FILE = "replay.json"


def finish(
    arguments: argparse.Namespace,
    out: Path,
    done: Simulated,
    started: float,
    learnt: Mapping[tuple[str, str], str],
) -> int:
    """Score, draw and tell a run that has been logged; its exit status."""
    from hatn_sim.commands.console import make_console
    from hatn_sim.commands.run_names import exit_status
    from hatn_sim.datatypes import Kind
    from hatn_sim.evaluation.seen import with_seen
    from hatn_sim.log import read_run
    from hatn_sim.report.table import score_table, scores_json, write_scores
    from hatn_sim.score.prediction import score_run
    from hatn_sim.score.samples import clustered_over

    scoring = time.monotonic()
    logged = read_run(out)
    scores = with_seen(score_run(logged), learnt)
    write_scores(out, scores)
    taken_s = done.seconds + time.monotonic() - scoring
    shown: list[Path] = []
    if not arguments.no_picture:
        shown = show_run(logged, out, arguments.quiet, not arguments.no_page)
    status = exit_status(arguments, logged.ids)
    if not arguments.quiet:
        tell_everyday_braking(logged)
    replayed = write_replay(logged, out, done.replay)
    if arguments.json:
        print(scores_json([*scores, *replayed, *rates(logged, done.frames, taken_s)]))
        return status
    make_console().print(score_table(scores, clustered_over([logged])))
    if done.replay is not None:
        from hatn_sim.report.replay_table import replay_table

        make_console().print(replay_table(str(logged.header["scene"]), *done.replay))
    walking = int((logged.kinds == Kind.PEDESTRIAN).sum())
    seen = f"{len(logged.ids) - walking} vehicles"
    seen += f" and {walking} pedestrians" if walking else ""
    print(
        f"{done.frames} steps of {DT_S:g} s, {seen}, in {taken_s:.1f} s, "
        f"log and scores included: {rate_text(done.frames / taken_s)} steps per second, "
        f"{rate_text(DT_S * done.frames / taken_s)} times real time"
    )
    tell_counterfactuals(logged)
    before_s = done.began - started
    print(f"before that {before_s:.1f} s to start and for {arguments.warm_up:g} s of warm-up")
    for path in shown:
        print(f"to look at: {path}")
    print(f"log and scores in {out}")
    return status


def tell_counterfactuals(logged: Run) -> None:
    """What branches said of the advice, and the weights of costs."""
    if logged.counterfactuals is None:
        return
    from hatn_sim.score.counterfactual import CounterfactualSettings
    from hatn_sim.score.counterfactual_tally import tally, tally_words

    print("\n".join(tally_words(tally(logged.counterfactuals), CounterfactualSettings())))


def tell_everyday_braking(logged: Run) -> None:
    """A notice where evasive braking is everyday braking."""
    from hatn_sim.score.driven import driven_in
    from hatn_sim.score.everyday import everyday_braking_in

    found = everyday_braking_in(driven_in(logged))
    if found is not None:
        print(f"hatn-sim: {found}", file=sys.stderr)


def write_replay(logged: Run, out: Path, replay: tuple[Fidelity, Divergence] | None) -> list[Score]:
    """The figures of a replay inside SUMO, in a file of the run as well."""
    if replay is None:
        return []
    from hatn_sim.report.replay_table import replay_scores
    from hatn_sim.report.table import scores_json
    from hatn_sim.whole_file import save_whole

    scores = replay_scores(str(logged.header["scene"]), *replay)
    save_whole(out / REPLAY_FILE, scores_json(scores) + "\n")
    return scores


def rates(logged: Run, frames: int, taken_s: float) -> list[Score]:
    """How fast the run was; not for its scores.json, which is equal in equal runs."""
    from hatn_sim.score.samples import reported_name

    main = reported_name(logged, logged.predictors[0])
    scene, per_second = str(logged.header["scene"]), frames / taken_s
    return [
        Score(measure, main, scene, "all", "none", value, unit, frames, None, None)
        for measure, value, unit in (
            ("steps_per_second", per_second, "1/s"),
            ("real_time_factor", DT_S * per_second, "x"),
        )
    ]


def show_run(logged: Run, out: Path, quiet: bool, page: bool) -> list[Path]:
    """The picture of a run, and the page if wanted; where nothing can be drawn, a line says so.

    The page opens with the moment of the picture; without one, with the first.
    """
    from hatn_sim.commands.report import draw
    from hatn_sim.errors import InputError
    from hatn_sim.report.choice import choose_moment
    from hatn_sim.report.page.page import write_page

    shown: list[Path] = []
    moment = None
    try:
        moment = choose_moment(logged)
        shown += draw(logged, out, moment, animate=False)
    except InputError as error:
        if not quiet:
            print(f"hatn-sim: no picture: {error}", file=sys.stderr)
    return [write_page(logged, out, moment), *shown] if page else shown
