"""Starts, asks and ends the process in which SUMO lives (`sumo_worker.py`)."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

from hatn_sim.simulators.sumo_config import first_error

LEAVE_TIMEOUT_S = 10.0
"""How long a worker may take to finish the output files of a user's configuration."""


class WorkerDiedError(Exception):
    """The worker ended without an answer; the text says why as far as it is known."""


class SumoWorker:
    """A worker process: one question, one answer. It leaves when its pipe closes.

    So it also leaves when this process dies in whatever way.
    """

    def __init__(self, module: str = "hatn_sim.simulators.sumo_worker") -> None:
        """`module` is the program that the process runs."""
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 - close() closes it
        # The worker finds the modules that this process finds, and nothing in the current folder.
        modules = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            # Only what has no other threads can be forked.
            env=os.environ | {"PYTHONPATH": modules, "OPENBLAS_NUM_THREADS": "1"},
        )

    @property
    def pid(self) -> int:
        return self._process.pid

    def ask(self, message: object) -> Any:
        """The worker's answer. Raises WorkerDiedError."""
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            pickle.dump(message, self._process.stdin, protocol=5)
            self._process.stdin.flush()
            return pickle.load(self._process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise WorkerDiedError(self.complaint() or self._last_words()) from None

    def complaint(self) -> str | None:
        """The first error that SUMO printed, if any: to be asked when SUMO has given up."""
        return first_error(self._printed())

    def close(self) -> None:
        """Lets the worker leave, or ends it if it does not. May be called again."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):  # what was still to be written cannot be
                    pipe.close()
        try:
            self._process.wait(LEAVE_TIMEOUT_S)
        except BaseException as reason:  # too slow, or ctrl-C while waiting
            self._process.kill()
            self._process.wait()
            if not isinstance(reason, subprocess.TimeoutExpired):
                raise
        finally:
            self._words.close()

    def _last_words(self) -> str:
        code = self._process.wait()
        lines = [line for line in self._printed().splitlines() if line.strip()]
        ending = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
        # A Python error's last line is the one that names it.
        if code > 0 and lines:
            return f"its process ended ({ending}): {lines[-1].strip()}"
        return f"its process ended ({ending})"

    def _printed(self) -> str:
        # The position is shared with the worker: read only when it has no more to say.
        self._words.seek(0)
        return self._words.read().decode("utf-8", "replace")


def one_line(text: str) -> str:
    """A text of several lines in one."""
    return " ".join(text.split())
