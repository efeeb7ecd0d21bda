"""Children of a process: what they read, how many there are, and that none is left."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from hatn_sim.simulators.forks import Forks


def test_a_child_reads_on_by_itself_and_opens_and_writes_nothing(tmp_path: Path) -> None:
    source, target, never = tmp_path / "in.txt", tmp_path / "out.txt", tmp_path / "never.txt"
    source.write_bytes(b"abcdefghij")
    forks = Forks(2)
    with source.open("rb", buffering=0) as reading, target.open("wb", buffering=0) as writing:
        reading.read(3)
        writing.write(b"before ")

        def work() -> bytes:
            writing.write(b"of the child ")
            try:
                never.write_bytes(b"")
            except OSError:
                return reading.read(4)
            return b"opened"

        number = forks.start(work)
        assert reading.read(2) == b"de"
        assert forks.result(number) == b"defg"
        assert reading.read(2) == b"fg"
        writing.write(b"after")
    assert target.read_bytes() == b"before after"
    assert not never.exists()


def test_children_are_bounded_and_what_fails_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    forks, pids, fork = Forks(2), list[int](), os.fork

    def noted() -> int:
        pids.append(fork())
        return pids[-1]

    monkeypatch.setattr(os, "fork", noted)

    def fail() -> bytes:
        raise ValueError

    numbers = [forks.start(work) for work in (fail, bytes, lambda: b"x" * 10**6, lambda: b"last")]
    assert [forks.result(number) for number in reversed(numbers)] == [b"last", b"x" * 10**6] + [
        None
    ] * 2
    slow = [forks.start(lambda: time.sleep(60) or b"") for _ in range(2)]
    forks.end()
    assert len(slow) == 2 and len(pids) == 6
    for pid in pids:
        with pytest.raises(ChildProcessError):
            os.waitpid(pid, os.WNOHANG)
