"""Children of this process that carry on with a copy of all it holds, cut off from its files.

`os.fork` copies a running simulation exactly. But what is open is not copied, it is shared: a child
that wrote to an inherited file, or read on in one, would do so for its parent as well. So a child
here writes into nothing but its own result, reads on in files of its own, and can open no others.
"""

from __future__ import annotations

import fcntl
import gc
import os
import resource
import signal
import stat
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Final, NoReturn

LONGEST_S: Final = 120
"""A child that is not done by then is ended by its own alarm: nobody waits for it for ever."""
MAC_PATH_BYTES: Final = 1024
"""Of `F_GETPATH`, which macOS asks for a buffer of this size."""


class Forks:
    """Children at work, at most `at_once` of them, each known by its number.

    A child gives its result in a file without a name, so that it never waits for a reader. One that
    dies, in whatever way, has the result None.
    """

    def __init__(self, at_once: int) -> None:
        self._at_once = at_once
        self._count = 0
        self._working: dict[int, tuple[int, IO[bytes]]] = {}  # pid -> number, file of the result
        self._results: dict[int, bytes | None] = {}

    def start(self, work: Callable[[], bytes]) -> int:
        """Lets a child do the work; waits before where enough are at it. Returns its number."""
        while len(self._working) >= self._at_once:
            self._gather(*os.waitpid(-1, 0))
        number, self._count = self._count, self._count + 1
        file = _nameless_file()
        # The parent may read on before the child gets to ask.
        offsets = _read_offsets()
        try:
            pid = os.fork()
        except OSError:  # no process or no memory left for one more
            file.close()
            self._results[number] = None
            return number
        if pid == 0:
            _do(work, file.fileno(), offsets)
        self._working[pid] = number, file
        return number

    def result(self, number: int) -> bytes | None:
        """What a child has made, None where it died; waits for it. Can be asked for once."""
        while number not in self._results:
            pid = next(pid for pid, (other, _) in self._working.items() if other == number)
            self._gather(*os.waitpid(pid, 0))
        return self._results.pop(number)

    def reap(self) -> None:
        """Takes in the results of those that are done, without waiting: leaves no zombies."""
        for pid in list(self._working):
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                self._gather(ended, status)

    def end(self) -> None:
        """Ends all that are still at work."""
        for pid in list(self._working):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            self._gather(*os.waitpid(pid, 0))
        self._results.clear()

    def _gather(self, pid: int, status: int) -> None:
        number, file = self._working.pop(pid)
        with file:
            if status == 0:
                file.seek(0)
            # Whoever leaves by SUMO's own exit leaves nothing.
            self._results[number] = (file.read() or None) if status == 0 else None


def _nameless_file() -> IO[bytes]:
    if sys.platform == "linux":
        return os.fdopen(os.memfd_create("branch"), "w+b", buffering=0)
    return tempfile.TemporaryFile(buffering=0)


def _do(work: Callable[[], bytes], result: int, offsets: Mapping[int, int]) -> NoReturn:
    """The whole life of a child. Whatever happens, nothing of the parent's ending runs in it."""
    status = 1
    try:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(LONGEST_S)
        gc.disable()
        _cut_off(result, offsets)
        rest = memoryview(work())
        while rest:
            rest = rest[os.write(result, rest) :]
        status = 0
    finally:
        os._exit(status)


def _open_files() -> list[int]:
    """The descriptors open in this process."""
    found: list[int] = []
    for entry in Path("/dev/fd").iterdir():
        with suppress(OSError):  # the one that listed them is closed by now
            os.fstat(int(entry.name))
            found.append(int(entry.name))
    return found


def _read_offsets() -> dict[int, int]:
    """Descriptor -> how far it has been read, of all regular files open for reading only."""
    return {
        number: os.lseek(number, 0, os.SEEK_CUR)
        for number in _open_files()
        if stat.S_ISREG(os.fstat(number).st_mode)
        and fcntl.fcntl(number, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY
    }


def _cut_off(kept: int, offsets: Mapping[int, int]) -> None:
    """Leaves a child no descriptor that it shares with its parent, but for the one `kept`."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in _open_files():
        if number in (kept, nothing):
            continue
        if number in offsets:
            own = os.open(_path_of(number), os.O_RDONLY)
            os.lseek(own, offsets[number], os.SEEK_SET)
            os.dup2(own, number)
            os.close(own)
        else:
            os.dup2(nothing, number)
    os.close(nothing)
    # What is open stays open, but no file can be opened, made or emptied any more.
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, most))


def _path_of(number: int) -> str:
    """By which a file that is open can be opened anew, with a place of its own to read on."""
    if sys.platform == "darwin":
        path = fcntl.fcntl(number, fcntl.F_GETPATH, bytes(MAC_PATH_BYTES))
        return os.fsdecode(path.rstrip(b"\0"))
    return f"/proc/self/fd/{number}"
