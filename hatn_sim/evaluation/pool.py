"""Work over all cores: each item in one of several processes, which talk to those who wait."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import connection, get_context, parent_process
from typing import Any, Final, TypeVar

from hatn_sim.errors import HatnSimError

Item = TypeVar("Item")
Result = TypeVar("Result")
Show = Callable[[int, int], None]
"""(number of the item, steps done so far)"""

TELL_EVERY_S: Final = 0.25
_line: tuple[Any, Any] | None = None
"""Of a working process: the queue of what it tells, and the event that says it is to stop."""


class WorkerKilledError(HatnSimError):
    """A process was killed from outside, and with it all others."""


class Stopped(Exception):  # noqa: N818 - nothing is wrong
    """Another item failed, or somebody pressed ctrl-C."""


@dataclass
class Teller:
    """What the work on an item tells with."""

    show: Callable[[int], None]
    stopped: Callable[[], bool]
    _told: float = field(default=0.0, init=False)

    def tell(self, steps: int) -> None:
        """Called at every step. Raises Stopped where the work is not wanted any more."""
        if self.stopped():
            raise Stopped
        now = time.monotonic()
        if now - self._told >= TELL_EVERY_S:
            self._told = now
            self.show(steps)


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def work_on(
    work: Callable[[Item, Teller], Result], items: Sequence[Item], workers: int, show: Show
) -> Iterator[tuple[int, Result]]:
    """(number, result) of every item, as they get ready.

    `work` and the items are sent to processes of their own, but for one worker, which is this
    process. The first error, or ctrl-C, stops all others at their next step and is raised here; to
    be ended (SIGTERM) is taken as ctrl-C, so that nothing is left behind.

    Raises:
        WorkerKilledError: a process was killed, as by a machine that has no memory left.
    """
    workers = min(workers, len(items))
    if workers <= 1:
        for number, item in enumerate(items):
            yield number, work(item, Teller(_showing(show, number), lambda: False))
        return
    context = get_context("spawn")
    told, stop = context.SimpleQueue(), context.Event()
    with (
        _signal_does(signal.SIGTERM, signal.default_int_handler),
        ProcessPoolExecutor(workers, context, _begin, (told, stop)) as pool,
    ):
        # The processes inherit this: who waits for them stops them.
        with _signal_does(signal.SIGINT, signal.SIG_IGN):
            waiting: dict[Future[Result], int] = {
                pool.submit(_do, work, number, item): number for number, item in enumerate(items)
            }
        try:
            while waiting:
                ready, _ = wait(waiting, TELL_EVERY_S, FIRST_COMPLETED)
                while not told.empty():
                    show(*told.get())
                for future in ready:
                    yield waiting.pop(future), future.result()
        except BrokenProcessPool:
            raise WorkerKilledError(
                "a process was killed from outside, perhaps for lack of memory; try fewer --workers"
            ) from None
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


def _showing(show: Show, number: int) -> Callable[[int], None]:
    return lambda steps: show(number, steps)


@contextmanager
def _signal_does(number: int, what: Any) -> Generator[None, None, None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, what)
    try:
        yield
    finally:
        signal.signal(number, before)


def _begin(told: Any, stop: Any) -> None:
    """The beginning of a working process."""
    global _line
    _line = told, stop
    os.environ["OMP_NUM_THREADS"] = "1"  # every core has a process already
    threading.Thread(target=_leave_with_parent, daemon=True).start()


def _leave_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _do(work: Callable[[Any, Teller], Any], number: int, item: Any) -> Any:
    assert _line is not None
    told, stop = _line

    def show(steps: int) -> None:
        told.put((number, steps))

    return work(item, Teller(show, stop.is_set))
