"""What workers are forked from: `python -m hatn_sim.simulators.sumo_nursery MODULE`.

It imports the program of the workers, which takes most of their start, and nothing of SUMO runs
in it: a worker forked from it is there in milliseconds and as fresh as one started by itself. It
hears of what is wanted over the socket that is its standard input, and leaves when that closes.
"""

from __future__ import annotations

import importlib
import os
import signal
import socket
import struct
import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Final, NoReturn

REQUEST: Final = struct.Struct("=cq")
"""`FORK` with the worker's standard input, output and error as descriptors beside it, or `ASK`
with the id of a worker."""
ANSWER: Final = struct.Struct("=?q")
"""Of `FORK`: there is a worker, its id. Of `ASK`: it has ended, its exit code."""
FORK: Final = b"f"
ASK: Final = b"a"
FILES: Final = 3


def main() -> None:
    """Forks workers and tells of their end, until nobody is there to want it."""
    # Ctrl-C reaches the whole process group; whoever runs us decides when to end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Where the program was started with this ignored, nobody's end could be asked for.
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    program: Callable[[], None] = importlib.import_module(sys.argv[1]).main
    control = socket.socket(fileno=0)
    while True:
        request, files, *_ = socket.recv_fds(control, REQUEST.size, FILES)
        if len(request) < REQUEST.size:
            return
        kind, number = REQUEST.unpack(request)
        if kind == FORK:
            answer = _fork(program, files)
            for one in files:
                os.close(one)
        else:
            ended, status = os.waitpid(number, os.WNOHANG)
            answer = bool(ended), os.waitstatus_to_exitcode(status)
        control.sendall(ANSWER.pack(*answer))


def _fork(program: Callable[[], None], files: Sequence[int]) -> tuple[bool, int]:
    try:
        pid = os.fork()
    except OSError:  # no process or no memory left for one more
        return False, 0
    if pid == 0:
        _work(program, files)
    return True, pid


def _work(program: Callable[[], None], files: Sequence[int]) -> NoReturn:
    """The whole life of a worker."""
    status = 1
    try:
        for target, number in enumerate(files):  # the first takes the place of the socket
            os.dup2(number, target)
            os.close(number)
        program()
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    main()
