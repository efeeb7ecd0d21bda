"""A full disk costs one line: what was there stays, and nothing is left beside it."""

from __future__ import annotations

import csv
import os
import resource
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hatn_sim.datatypes import Score
from hatn_sim.errors import InputError
from hatn_sim.evaluation import table
from hatn_sim.evaluation.paper import EDN
from hatn_sim.line_choice import save_line_choice, shipped_line_choice
from hatn_sim.report.figures import new_chart, save_figure
from hatn_sim.report.steps_figure import write_steps
from hatn_sim.report.table import SCORES_FILE, write_scores
from hatn_sim.score.steps import StepErrors
from hatn_sim.whole_file import save_csv, save_whole, write_whole


@contextmanager
def little_room(size_bytes: int) -> Generator[None, None, None]:
    """No file may grow beyond a size."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def score() -> Score:
    return Score(
        measure="ade_3s", predictor="hatn", scene="tjunction", subset="all", unit="m",
        adapt="none", value=0.5, std=0.1, low=0.4, high=0.6, n=10,
    )  # fmt: skip


def steps() -> StepErrors:
    some = np.linspace(0.1, 3.0, 30)
    return StepErrors("tjunction", "hatn", "all", some, some, some, some, 10)


WRITERS: dict[str, Callable[[Path], object]] = {
    "line_choice.json": lambda path: save_line_choice(path, shipped_line_choice(), {}),
    "rows.json": lambda path: table.write_rows(
        path, [table.AblationRow("edn.a", "Frenet", (score(),))]
    ),
    "edn.csv": lambda path: table.write_csv(path, table.compare(EDN[0], [])),
    "steps.csv": lambda path: write_steps(path, [steps()]),
    SCORES_FILE: lambda path: write_scores(path.parent, [score()]),
    "chart.png": lambda path: save_figure(new_chart((2.0, 2.0)), [path]),
    "chart.pdf": lambda path: save_figure(new_chart((2.0, 2.0)), [path]),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_one_line_and_leaves_the_old_file(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(b"old")
    with little_room(100), pytest.raises(InputError) as full:
        WRITERS[name](path)
    assert str(full.value) == f"{path}: cannot be written: File too large; make room there"
    assert [one.name for one in tmp_path.iterdir()] == [name]
    assert path.read_bytes() == b"old"
    WRITERS[name](path)
    assert path.stat().st_size > 100


def test_whatever_stops_a_writer_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "some.txt"
    save_whole(path, "old")

    def write(file: Path) -> None:
        file.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(path, write)
    assert [one.name for one in tmp_path.iterdir()] == ["some.txt"]
    assert path.read_text() == "old"


def test_links_and_devices_stay_what_they_are(tmp_path: Path) -> None:
    """A device replaced by a file would be lost to the whole system."""
    real, link, pipe = (tmp_path / name for name in ("real", "link", "pipe"))
    link.symlink_to(real)
    for text in ("new", "newer"):
        save_whole(link, text)
        assert link.is_symlink() and real.read_text() == text
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    save_whole(pipe, "passed on")
    assert os.read(reader, 100) == b"passed on"
    os.close(reader)
    assert pipe.is_fifo() and sorted(tmp_path.iterdir()) == [link, pipe, real]


def test_the_folder_is_made_and_text_is_utf8_with_plain_line_ends(tmp_path: Path) -> None:
    path = tmp_path / "new" / "some.csv"
    rows = [("a", "b"), ("größer, als", None), (1, 0.5)]
    save_csv(path, rows)
    assert path.read_bytes() == 'a,b\n"größer, als",\n1,0.5\n'.encode()
    with path.open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file)) == [["a", "b"], ["größer, als", ""], ["1", "0.5"]]


def test_a_place_where_nothing_can_be_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    path = tmp_path / "file" / "some.txt"
    with pytest.raises(InputError) as refused:
        save_whole(path, "text", "choose another --out")
    assert str(refused.value).startswith(f"{path}: cannot be written: ")
    assert str(refused.value).endswith("; choose another --out")
