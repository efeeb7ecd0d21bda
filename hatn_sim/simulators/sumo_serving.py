"""How a worker process is asked: pickles over its standard input and output, until that closes.

The first messages it reads are `Surroundings` and SUMO's options; it answers with `Started`, or
with `Refused` where SUMO does not take them. Every further message is answered by the simulation,
or by `Failed` where SUMO gives up. SUMO's own words go to standard error, which the parent keeps.
The library is handed in, not imported.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from hatn_sim.simulators.sumo_lanes import LaneTable
from hatn_sim.simulators.sumo_messages import (
    Failed,
    Leave,
    RawFrame,
    Refused,
    Started,
    Surroundings,
    WindowClosed,
)


class Served(Protocol):
    """A simulation that a worker process keeps and asks step by step."""

    @property
    def lane_table(self) -> LaneTable: ...

    def observe(self) -> RawFrame: ...

    @property
    def cannot_branch(self) -> str | None: ...

    def answer(self, message: Any) -> object: ...

    def close(self) -> None: ...


def serve(start: Callable[[Sequence[str]], Served], sumo: Any) -> None:
    """Serves one simulation of the library `sumo` over the pipes, until they close."""
    # Ctrl-C reaches the whole process group; whoever runs us decides when to end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests = sys.stdin.buffer
    with os.fdopen(os.dup(1), "wb") as replies:
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)  # SUMO prints there too; only our messages may enter the pipe
        try:
            _serve(start, sumo, requests, replies)
        except (EOFError, BrokenPipeError):
            return  # nobody is listening any more


def _serve(
    start: Callable[[Sequence[str]], Served], sumo: Any, requests: Any, replies: Any
) -> None:
    gives_up = (sumo.TraCIException, sumo.FatalTraCIError)

    def reply(message: object) -> None:
        pickle.dump(message, replies, protocol=5)
        replies.flush()

    surroundings: Surroundings = pickle.load(requests)
    if surroundings.folder:
        os.chdir(surroundings.folder)
    os.environ.clear()
    os.environ.update(surroundings.variables)
    options = pickle.load(requests)
    if isinstance(options, Leave):
        return
    try:
        simulation = start(options)
    except gives_up as error:
        reply(Refused(str(error)))
        return
    try:
        first = simulation.observe()
        reply(Started(simulation.lane_table, first, simulation.cannot_branch))
        while True:
            message = pickle.load(requests)
            if isinstance(message, Leave):
                return
            try:
                answer = simulation.answer(message)
            except gives_up as error:
                reply(Failed(str(error)) if _has_net(sumo) else WindowClosed())
                return
            reply(answer)
    finally:
        simulation.close()


def _has_net(sumo: Any) -> bool:
    """Whether there is a simulation still: with its window, the user closes that, too."""
    try:
        sumo.simulation.getTime()
    except (sumo.TraCIException, sumo.FatalTraCIError):
        return False
    return True
