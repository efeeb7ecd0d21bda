"""XML of users: read as the standard library reads it, and refused where it is an attack."""

from __future__ import annotations

import gzip
import xml.etree.ElementTree as ElementTree
import zlib
from pathlib import Path

import pytest

from hatn_sim import safe_xml
from hatn_sim.errors import InputError
from hatn_sim.safe_xml import iterparse_xml, parse_xml

STEPS = "<steps a='1'>" + "".join(
    f"<step t='{k}'><car id='v{k}' x='{k / 7}'/>é</step>\n" for k in range(20_000)
) + "</steps>"  # fmt: skip
BOMB = """<?xml version="1.0"?>
<!DOCTYPE steps [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><steps>&b;</steps>"""


@pytest.fixture(params=["plain", "gzip"])
def steps(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / "steps.xml"
    text = STEPS.encode()
    path.write_bytes(gzip.compress(text) if request.param == "gzip" else text)
    return path


def text_of(element: ElementTree.Element) -> bytes:
    element.tail = None
    return ElementTree.tostring(element)


def test_reads_what_the_standard_library_reads(steps: Path) -> None:
    expected = ElementTree.fromstring(STEPS)
    assert ElementTree.tostring(parse_xml(steps)) == ElementTree.tostring(expected)
    expected_steps = [text_of(child) for child in expected]
    assert [text_of(child) for child in iterparse_xml(steps, "steps")] == expected_steps


def test_a_stream_forgets_what_it_has_handed_out(tmp_path: Path) -> None:
    path = tmp_path / "steps.xml"
    path.write_text(STEPS)
    alive = 0
    for child in iterparse_xml(path, "steps"):
        alive = max(alive, len(list(child.iter())))
    assert alive == 2


def refused(path: Path, content: bytes) -> str:
    path.write_bytes(content)
    with pytest.raises(InputError) as whole:
        parse_xml(path)
    with pytest.raises(InputError) as stream:
        list(iterparse_xml(path, "steps"))
    assert str(whole.value) == str(stream.value)
    assert "\n" not in str(whole.value)
    return str(whole.value).removeprefix(str(path))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_document_types_are_refused(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "bomb.xml"
    line = refused(path, BOMB.encode(encoding))
    assert line.startswith(": expected XML without a document type, found <!DOCTYPE ...>")
    # A long comment before it does not hide it.
    hidden = BOMB.replace("<!DOCTYPE", "<!--" + "x" * 600_000 + "--><!DOCTYPE")
    assert refused(path, hidden.encode(encoding)) == line
    assert refused(path, gzip.compress(hidden.encode(encoding))) == line


def test_gzip_bombs_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.xml.gz"
    pump = zlib.compressobj(9, wbits=31)
    parts = [pump.compress(b"<steps>")]
    parts += [pump.compress(b"<step/>" + b" " * (1 << 20)) for _ in range(64)]
    parts += [pump.compress(b"</steps>"), pump.flush()]
    assert refused(path, b"".join(parts)).startswith(
        ": expected gzip that expands up to 200 times, found more: this looks like a decompression"
    )


def test_sizes_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "steps.xml"
    path.write_text(STEPS)
    monkeypatch.setattr(safe_xml, "MAX_DOCUMENT_BYTES", 1 << 19)
    with pytest.raises(InputError, match="expected at most 0 MiB and 5000000 tags of XML, found"):
        parse_xml(path)
    monkeypatch.setattr(safe_xml, "MAX_RECORD_BYTES", 1 << 19)
    assert sum(1 for _ in iterparse_xml(path, "steps")) == 20_000
    path.write_text("<steps><step>" + "x" * (1 << 20) + "</step></steps>")
    with pytest.raises(InputError, match="expected records of at most 0 MiB and 5000000 tags in"):
        list(iterparse_xml(path, "steps"))


def test_tags_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "steps.xml"
    monkeypatch.setattr(safe_xml, "MAX_TAGS", 1000)
    # Many records are no matter for a stream, one with many elements is; files of 250 kB each.
    path.write_text("<steps>" + "<step/>" * 36_000 + "</steps>")
    with pytest.raises(InputError, match="and 1000 tags of XML, found more"):
        parse_xml(path)
    monkeypatch.setattr(safe_xml, "MAX_TAGS", 40_000)
    assert sum(1 for _ in iterparse_xml(path, "steps")) == 36_000
    path.write_text("<steps><step>" + "<a/>" * 62_000 + "</step></steps>")
    with pytest.raises(InputError, match="and 40000 tags in <steps>, found a larger one"):
        list(iterparse_xml(path, "steps"))


def test_damage_is_told_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "steps.xml"
    text = STEPS.encode()
    assert refused(path, b"").startswith(":1: not well-formed XML: no element found")
    assert refused(path, b"x,y\n1,2\n").startswith(":1: not well-formed XML: syntax error")
    assert refused(path, text[: len(text) // 2]).startswith(":10193: not well-formed XML: ")
    assert refused(path, text.replace(b"</step>", b"</stop>", 1)).startswith(
        ":1: not well-formed XML: mismatched tag"
    )
    assert refused(path, gzip.compress(text)[:-2000]).startswith(": the gzip stream is damaged")
    assert refused(path, b"\x1f\x8bno gzip at all").startswith(": the gzip stream is damaged")
    assert refused(path, b"<?xml version='1.0' encoding='no-such'?><steps/>").startswith(
        ": the encoding that it declares cannot be read: "
    )
    with pytest.raises(InputError, match=r"expected XML of <net>, found <steps>"):
        path.write_text(STEPS)
        list(iterparse_xml(path, "net"))
    with pytest.raises(InputError, match=r"missing\.xml: cannot be read: No such file"):
        parse_xml(tmp_path / "missing.xml")
