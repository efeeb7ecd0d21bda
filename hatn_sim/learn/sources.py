"""Traffic -> samples, whatever it comes from, every piece a job on a core of its own."""

from __future__ import annotations

import multiprocessing
import os
import signal
import traceback
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from multiprocessing import get_context
from pathlib import Path

from hatn_sim.datatypes import CASE_HISTORY_FRAMES, HISTORY_FRAMES, Frame, Simulator
from hatn_sim.errors import HatnSimError, SimulatorError
from hatn_sim.learn.cache import SampleCache
from hatn_sim.learn.dataset import Samples, concatenate, samples_of_run
from hatn_sim.learn.split import Traffic
from hatn_sim.learn.watch import Watch
from hatn_sim.loop import warm_up
from hatn_sim.simulators.recorded import RecordedSimulator
from hatn_sim.traffic import open_traffic


def samples_of(traffic: Traffic) -> Samples:
    """Play a piece of traffic and cut its samples. Raises InputError, SimulatorError."""
    with closing(open_traffic(traffic.scenario)) as simulator:
        first = simulator.reset(traffic.seed)
        first = warm_up(simulator, first, round(traffic.warm_up_s / simulator.dt_s))
        recorded = isinstance(simulator, RecordedSimulator)
        has_cases = recorded and simulator.recording.ids_by == "cases"
        return samples_of_run(
            simulator.road,
            _frames(simulator, first, traffic.duration_s),
            history_frames=CASE_HISTORY_FRAMES if has_cases else HISTORY_FRAMES,
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
        counted = f"{sum(map(len, have)):,} samples"
        watch.step(f"traffic to {part}", len(have), len(traffic), f"{counted}{words}")

    tell(f", {len(traffic) - len(missing)} from the cache")
    if missing:
        with _workers(min(workers, len(missing))) as pool:
            jobs = {pool.submit(_cut, traffic[k]): k for k in missing}
            for job in as_completed(jobs):
                k = jobs[job]
                found[k] = samples = _result(job, traffic[k])
                if (trouble := cache.store(traffic[k], samples)) is not None:
                    watch.say(trouble)
                tell()
    return concatenate([samples for samples in found if samples is not None])


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _workers(count: int) -> Generator[ProcessPoolExecutor]:
    """Processes that are gone when it ends, in whatever way."""
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, get_context("spawn"), initializer=_leave_on_ctrl_c)
    try:
        yield pool
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _leave_on_ctrl_c() -> None:
    """The command that is interrupted speaks; its workers go without a word."""
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))


def _cut(traffic: Traffic) -> Samples:
    """`samples_of` in a worker, whose errors are one line that names the traffic."""
    try:
        return samples_of(traffic)
    except HatnSimError as error:
        raise type(error)(f"{traffic.name}: {error}") from None
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise SimulatorError(
            f"{traffic.name}: failed: {type(error).__name__}: {error} "
            f"({Path(last.filename).name}:{last.lineno})"
        ) from None


def _result(job: Future[Samples], traffic: Traffic) -> Samples:
    try:
        return job.result()
    except BrokenProcessPool:
        raise SimulatorError(
            f"{traffic.name}: a worker process died, for lack of memory perhaps; give the same "
            "command again, with fewer --workers"
        ) from None


def _frames(simulator: Simulator, first: Frame, duration_s: float | None) -> Iterator[Frame]:
    """`first` and what follows in `duration_s`, or to the end."""
    steps = None if duration_s is None else round(duration_s / simulator.dt_s)
    frame, done = first, 0
    yield frame
    while not frame.done and done != steps:
        frame = simulator.step()
        done += 1
        yield frame
