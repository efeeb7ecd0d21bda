"""Starts, asks and ends the processes in which SUMO lives (`sumo_worker.py`)."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import IO, Any, Final, Protocol

from hatn_sim.simulators.sumo_config import first_error
from hatn_sim.simulators.sumo_messages import Leave, Surroundings
from hatn_sim.simulators.sumo_nursery import ANSWER, ASK, FORK, REQUEST

WORKER: Final = "hatn_sim.simulators.sumo_worker"
NURSERY: Final = "hatn_sim.simulators.sumo_nursery"
LEAVE_TIMEOUT_S: Final = 10.0
"""How long a worker may take to finish the output files of a user's configuration."""
LONGEST_NAP_S: Final = 0.02
"""Between two looks at whether a worker has left."""


FORKS: Final = sys.platform == "linux"


class WorkerDiedError(Exception):
    """The worker ended without an answer; the text says why as far as it is known."""


class NurseryDiedError(WorkerDiedError):
    """What workers are forked from has died, and can be begun anew."""


class SumoWorker:
    """A worker process: one question, one answer. It leaves when its pipe closes.

    So it also leaves when this process dies in whatever way.
    """

    def __init__(self, workers: Workers) -> None:
        """Raises WorkerDiedError where no process can be started."""
        self._owner = os.getpid()
        try:
            try:
                self._open(workers)
            except NurseryDiedError:  # just now; who knows what it has forked over those pipes
                self._open(workers)
        except OSError as error:  # no files left, or no processes
            raise WorkerDiedError(f"its process could not be started: {error.strerror}") from None
        with suppress(OSError):  # it is gone: the first question will tell
            pickle.dump(Surroundings(_folder(), dict(os.environ)), self._requests, protocol=5)

    def _open(self, workers: Workers) -> None:
        with ExitStack() as opened:
            self._words: IO[bytes] = opened.enter_context(tempfile.TemporaryFile())
            asked, self._requests = map(opened.enter_context, _pipe())
            self._answers, answer = map(opened.enter_context, _pipe())
            files = asked.fileno(), answer.fileno(), self._words.fileno()
            self._process = workers.start(files)
            asked.close()
            answer.close()
            opened.pop_all()  # the others stay open

    @property
    def pid(self) -> int:
        return self._process.pid

    def ask(self, message: object) -> Any:
        """The worker's answer. Raises WorkerDiedError."""
        self.tell(message)
        return self.hear()

    def tell(self, message: object) -> None:
        """Asks without waiting for the answer, which `hear` gives. Raises WorkerDiedError."""
        try:
            pickle.dump(message, self._requests, protocol=5)
            self._requests.flush()
        except OSError:
            raise self._died() from None

    def hear(self) -> Any:
        """The answer to what was told. Raises WorkerDiedError."""
        try:
            return pickle.load(self._answers)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise self._died() from None

    def complaint(self) -> str | None:
        """The first error that SUMO printed, if any: to be asked when SUMO has given up."""
        return first_error(self._printed())

    def close(self) -> None:
        """Lets the worker leave, or ends it if it does not. May be called again."""
        self.dismiss()
        self.await_end()

    def dismiss(self) -> None:
        """Lets the worker leave, which takes it a while. `await_end` has to follow."""
        # What was forked off this process may hold the pipes, too: closing them is not enough.
        if os.getpid() == self._owner:
            with suppress(WorkerDiedError, ValueError):
                self.tell(Leave())
        self._close_files()

    def await_end(self) -> None:
        """Waits until a dismissed worker has left, or ends it if it does not."""
        try:
            self._process.wait(LEAVE_TIMEOUT_S)
        except BaseException as reason:  # too slow, or ctrl-C while waiting
            self._process.kill()
            self._process.wait()
            if not isinstance(reason, subprocess.TimeoutExpired):
                raise
        finally:
            self._words.close()

    def _close_files(self) -> None:
        for pipe in (self._requests, self._answers):
            with suppress(OSError):  # what was still to be written cannot be
                pipe.close()

    def _died(self) -> WorkerDiedError:
        return WorkerDiedError(self.complaint() or self._last_words())

    def _last_words(self) -> str:
        return _ending(self._process.wait(), self._printed())

    def _printed(self) -> str:
        # The position is shared with the worker: read only when it has no more to say.
        return _read(self._words)


class Workers:
    """Where workers come from: forked from a process that all of this program share.

    To be closed when no more are wanted: with the last `Workers` that process leaves. Workers that
    are there stay. On systems other than Linux they are started one by one: elsewhere
    forking without exec is not there, or not safe beside a system's own threads.
    """

    def __init__(self, module: str = WORKER) -> None:
        """`module` is the program that the processes run."""
        self._module = module
        self._nursery: _Nursery | None = None

    def start(self, files: Sequence[int]) -> _Process:
        """A process with these as its standard input, output and error.

        Raises WorkerDiedError where there can be none, NurseryDiedError where another try may do.
        """
        if not FORKS or not hasattr(os, "fork"):
            return _spawned((self._module,), files)
        if self._nursery is None or not self._nursery.is_of_use:
            self.close()
            self._nursery = _Nursery.shared(self._module)
        try:
            return self._nursery.fork(files)
        except WorkerDiedError as error:
            if self._nursery.is_of_use:  # there is no room for one more
                raise
            raise NurseryDiedError(str(error)) from None

    def close(self) -> None:
        """May be called again; `start` opens it anew."""
        nursery, self._nursery = self._nursery, None
        if nursery is not None:
            nursery.leave()


class _Process(Protocol):
    """A worker's process; as `subprocess.Popen`."""

    @property
    def pid(self) -> int: ...

    def wait(self, timeout: float | None = None) -> int: ...

    def kill(self) -> None: ...


class _Nursery:
    """The process that workers of a module are forked from, for this process only."""

    _known: Final[dict[str, _Nursery]] = {}
    _lock = threading.Lock()

    @classmethod
    def forget(cls) -> None:
        """In a child of this process: what another thread held there, nobody will let go of."""
        cls._lock = threading.Lock()
        cls._known.clear()

    @classmethod
    def shared(cls, module: str) -> _Nursery:
        """The one of the module, begun where there is none."""
        with cls._lock:
            found = cls._known.get(module)
            if found is None or not found.is_of_use:
                found = cls._known[module] = cls(module)
            found._users += 1
            return found

    def __init__(self, module: str) -> None:
        self._module, self._users, self._owner = module, 0, os.getpid()
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 - leave() closes it
        self._control, theirs = socket.socketpair()
        self._talking = threading.Lock()
        self.dropped: Final[deque[int]] = deque()
        """Workers whose simulators were never closed: whoever is not asked for never goes."""
        with theirs:
            files = theirs.fileno(), subprocess.DEVNULL, self._words.fileno()
            self._process = _spawned((NURSERY, module), files)

    @property
    def is_of_use(self) -> bool:
        """It runs, and is of this process: what is forked off this one has its own."""
        return self.is_own and self._process.poll() is None

    @property
    def is_own(self) -> bool:
        return os.getpid() == self._owner

    def fork(self, files: Sequence[int]) -> _Forked:
        for pid in [self.dropped.popleft() for _ in range(len(self.dropped))]:
            if self.exit_code(pid) is None:
                self.dropped.append(pid)
        there, pid = self._asked(FORK, 0, files)
        if not there:
            raise WorkerDiedError("its process could not be started: there is no room for one more")
        return _Forked(self, pid)

    def exit_code(self, pid: int) -> int | None:
        """Of a worker; None: it runs. To be asked for until it has ended, then no more.

        Raises WorkerDiedError where nobody knows any more.
        """
        ended, code = self._asked(ASK, pid)
        return code if ended else None

    def leave(self) -> None:
        """One user less; the process leaves with the last."""
        with self._lock:
            self._users -= 1
            if self._users > 0:
                return
            if self._known.get(self._module) is self:
                del self._known[self._module]
        if self.is_own:
            self._end()
        self._control.close()
        self._words.close()

    def _end(self) -> None:
        # Whoever was forked off this process may hold the socket, too.
        with suppress(OSError):
            self._control.shutdown(socket.SHUT_RDWR)
        self._process.wait()

    def _asked(self, kind: bytes, number: int, files: Sequence[int] = ()) -> tuple[bool, int]:
        if not self.is_own:
            raise WorkerDiedError("it belongs to another process")
        if self._control.fileno() < 0:
            raise WorkerDiedError("it has left")
        try:
            with self._talking:
                socket.send_fds(self._control, [REQUEST.pack(kind, number)], files)
                answer = self._control.recv(ANSWER.size, socket.MSG_WAITALL)
        except OSError:
            answer = b""
        except BaseException:
            # Ctrl-C between question and answer: nobody is to take that answer for another's.
            self._end()
            raise
        if len(answer) < ANSWER.size:
            with suppress(subprocess.TimeoutExpired):
                raise WorkerDiedError(_ending(self._process.wait(1.0), _read(self._words)))
            raise WorkerDiedError("its process could not be started")
        return ANSWER.unpack(answer)


if FORKS:
    os.register_at_fork(after_in_child=_Nursery.forget)


def _has_ended(pid: int) -> bool:
    """Of a process whose parent is no more: whoever is to take note of its end may never do so."""
    try:
        state = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0]
    except OSError:
        return True
    return state in (b"Z", b"X")


class _Forked:
    """A worker forked from a nursery."""

    def __init__(self, nursery: _Nursery, pid: int) -> None:
        self.pid = pid
        self._nursery = nursery
        self._code: int | None = None

    def __del__(self) -> None:
        if self._code is None:
            self._nursery.dropped.append(self.pid)

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code; 0 where nobody knows. Raises subprocess.TimeoutExpired."""
        until_s = time.monotonic() + (float("inf") if timeout is None else timeout)
        nap_s = 0.0005
        while self._code is None:
            try:
                self._code = self._nursery.exit_code(self.pid)
            except WorkerDiedError:
                if not self._nursery.is_own or _has_ended(self.pid):
                    self._code = 0
            if self._code is None:
                if time.monotonic() > until_s:
                    raise subprocess.TimeoutExpired(WORKER, timeout or 0.0)
                time.sleep(nap_s)
                nap_s = min(1.2 * nap_s, LONGEST_NAP_S)
        return self._code

    def kill(self) -> None:
        if self._code is None:  # what has ended keeps its id until it was asked for
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)


def _spawned(words: Sequence[str], files: Sequence[int]) -> subprocess.Popen[bytes]:
    """A Python program of this package in a process of its own."""
    # It finds the modules that this process finds, and nothing in the current folder.
    modules = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
    standard_input, output, errors = files
    return subprocess.Popen(
        [sys.executable, "-P", "-m", *words],
        stdin=standard_input,
        stdout=output,
        stderr=errors,
        # Only what has no other threads can be forked.
        env=os.environ | {"PYTHONPATH": modules, "OPENBLAS_NUM_THREADS": "1"},
    )


def _pipe() -> tuple[IO[bytes], IO[bytes]]:
    """Where to read, and where to write what is read there."""
    read, write = os.pipe()
    return os.fdopen(read, "rb"), os.fdopen(write, "wb")


def _folder() -> str:
    """Where this program is; "" where that folder is no more."""
    try:
        return str(Path.cwd())
    except FileNotFoundError:
        return ""


def _ending(code: int, printed: str) -> str:
    lines = [line for line in printed.splitlines() if line.strip()]
    ending = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    # A Python error's last line is the one that names it.
    if code > 0 and lines:
        return f"its process ended ({ending}): {lines[-1].strip()}"
    return f"its process ended ({ending})"


def _read(words: IO[bytes]) -> str:
    words.seek(0)
    return words.read().decode("utf-8", "replace")


def one_line(text: str) -> str:
    """A text of several lines in one."""
    return " ".join(text.split())
