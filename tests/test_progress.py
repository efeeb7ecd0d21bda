"""Bars and tables on a terminal."""

from __future__ import annotations

import io

import pytest
from rich.table import Table

from hatn_sim.commands.console import make_console
from hatn_sim.commands.progress import Progress, RunsProgress
from hatn_sim.commands.train_progress import TrainProgress
from hatn_sim.datatypes import DT_S

NAME = "a[b]c [/d]"
"""Of a user's file; in rich's markup a tag, and an error."""


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_names_are_shown_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with Progress(NAME, 1, DT_S, False) as progress:
        progress.show(1, 3)
    with RunsProgress([NAME], [1], DT_S, False) as runs:
        runs.show(0, 1)
        runs.finish(0, 1)
    with TrainProgress(False) as training:
        training.step("SGN", 2000, 2000, NAME)
        training.say(f"say {NAME}")
    shown = terminal.getvalue()
    assert shown.count(NAME) >= 4 and "1 of 1 steps" in shown and "2,000 of 2,000" in shown


def test_tables_show_names_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table(NAME, title=NAME)
    table.add_row(NAME)
    make_console().print(table)
    assert capsys.readouterr().out.count(NAME) == 3


@pytest.mark.parametrize("quiet", [True, False])
def test_elsewhere_there_are_plain_lines_or_none(
    capsys: pytest.CaptureFixture[str], quiet: bool
) -> None:
    with Progress(NAME, 2, DT_S, quiet) as progress:
        progress.show(1, 3)
        progress.show(2, 3)
    with RunsProgress([NAME], [None], DT_S, quiet) as runs:
        runs.show(0, 5)
        runs.finish(0, 7)
    lines = capsys.readouterr().err.splitlines()
    if quiet:
        assert lines == []
    else:
        first, second = lines
        assert first.startswith(f"{NAME}: 2 of 2 steps, 3 vehicles now, ")
        assert second == f"{NAME}: 7 steps, 1 of 1 runs"
