"""Traffic -> samples, whatever it comes from, every piece a job on a core of its own."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from hatn_sim.datatypes import CASE_HISTORY_FRAMES, HISTORY_FRAMES, Frame, Simulator
from hatn_sim.errors import HatnSimError, SimulatorError
from hatn_sim.evaluation.pool import Stopped, Teller, work_on
from hatn_sim.learn.cache import SampleCache
from hatn_sim.learn.dataset import Samples, concatenate, samples_of_run
from hatn_sim.learn.split import Traffic
from hatn_sim.learn.watch import Watch, counted
from hatn_sim.loop import warm_up
from hatn_sim.simulators.recorded import RecordedSimulator
from hatn_sim.traffic import open_traffic


@contextmanager
def played(
    traffic: Traffic, tell: Callable[[int], object] = lambda _: None
) -> Generator[tuple[Simulator, Iterator[Frame]], None, None]:
    """The simulator of a piece of traffic, and its frames; `tell` is told of every step.

    Raises InputError, SimulatorError.
    """
    with closing(open_traffic(traffic.scenario)) as simulator:
        first = simulator.reset(traffic.seed)
        first = warm_up(simulator, first, round(traffic.warm_up_s / simulator.dt_s))
        yield simulator, _frames(simulator, first, traffic.duration_s, tell)


def samples_of(traffic: Traffic, tell: Callable[[int], object] = lambda _: None) -> Samples:
    """Play a piece of traffic and cut its samples; `tell` is told of every step.

    Raises InputError, SimulatorError.
    """
    with played(traffic, tell) as (simulator, frames):
        recorded = isinstance(simulator, RecordedSimulator)
        has_cases = recorded and simulator.recording.ids_by == "cases"
        return samples_of_run(
            simulator.road,
            frames,
            history_frames=CASE_HISTORY_FRAMES if has_cases else HISTORY_FRAMES,
            choice=traffic.choice,
        )


def gather(
    part: str, traffic: Sequence[Traffic], cache: SampleCache, workers: int, watch: Watch
) -> Samples:
    """The samples of all traffic, in its order: out of the cache, or cut side by side.

    Raises HatnSimError, in one line that names the traffic, where a job fails; what the others
    have cut by then is in the cache.
    """
    found = [cache.load(one) for one in traffic]
    missing = [k for k, samples in enumerate(found) if samples is None]

    def tell(words: str = "") -> None:
        have = [samples for samples in found if samples is not None]
        cut = f"{sum(map(len, have)):,} samples"
        watch.step(f"traffic to {part}", len(have), len(traffic), f"{cut}{words}")

    tell(f", {len(traffic) - len(missing)} from the cache")
    jobs = [traffic[k] for k in missing]
    show = counted(lambda words: tell(f", {words}"))
    for number, samples in work_on(_cut, jobs, workers, show):
        found[missing[number]] = samples
        if (trouble := cache.store(jobs[number], samples)) is not None:
            watch.say(trouble)
        tell()
    return concatenate([samples for samples in found if samples is not None])


@contextmanager
def named(traffic: Traffic) -> Generator[None, None, None]:
    """Whatever goes wrong becomes one line that names the traffic."""
    try:
        yield
    except HatnSimError as error:
        raise type(error)(f"{traffic.name}: {error}") from None
    except Stopped:
        raise
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise SimulatorError(
            f"{traffic.name}: failed: {type(error).__name__}: {error} "
            f"({Path(last.filename).name}:{last.lineno})"
        ) from None


def _cut(traffic: Traffic, teller: Teller) -> Samples:
    """`samples_of` in a worker."""
    with named(traffic):
        return samples_of(traffic, teller.tell)


def _frames(
    simulator: Simulator, first: Frame, duration_s: float | None, tell: Callable[[int], object]
) -> Iterator[Frame]:
    """`first` and what follows in `duration_s`, or to the end."""
    steps = None if duration_s is None else round(duration_s / simulator.dt_s)
    frame, done = first, 0
    yield frame
    while not frame.done and done != steps:
        frame = simulator.step()
        done += 1
        tell(done)
        yield frame
