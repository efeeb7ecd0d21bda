"""XML files of users, plain or gzipped, read so that none of them can fill the memory.

Refused with an InputError: document types (and with them every entity of one's own), gzip streams
that expand beyond `MAX_RATIO`, documents larger than `MAX_DOCUMENT_BYTES` read as a whole, and
records larger than `MAX_RECORD_BYTES` in a stream, or either with more than `MAX_TAGS`.
"""

from __future__ import annotations

import gzip
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final, cast
from xml.etree.ElementTree import Element
from xml.parsers import expat

from hatn_sim.errors import InputError

MAX_RATIO: Final = 200
"""Expanded over compressed bytes. Traffic in XML compresses 10 to 40 times, a bomb 1,000 times."""
RATIO_FROM_BYTES: Final = 16 << 20
"""Below this many expanded bytes any ratio is harmless."""
MAX_DOCUMENT_BYTES: Final = 256 << 20
MAX_RECORD_BYTES: Final = 64 << 20
MAX_TAGS: Final = 5_000_000
"""An element of four bytes, `<a/>`, takes a hundred bytes of memory."""
_BLOCK_BYTES: Final = 1 << 18
_GZIP_MAGIC: Final = b"\x1f\x8b"


def parse_xml(path: Path) -> Element:
    """The root of a document read as a whole.

    Raises:
        InputError: not there, not well-formed, cut off, or refused as the module says.
    """
    parser = ElementTree.XMLParser()
    size = tags = 0
    for block in _checked_blocks(path):
        size += len(block)
        tags += block.count(b"<")
        if size > MAX_DOCUMENT_BYTES or tags > MAX_TAGS:
            raise InputError(
                f"{path}: expected at most {MAX_DOCUMENT_BYTES >> 20} MiB and {MAX_TAGS} tags of "
                "XML, found more; cut the file to the part that is needed"
            )
        with _told(path):
            parser.feed(block)
    with _told(path):
        return parser.close()


def iterparse_xml(path: Path, root_tag: str) -> Iterator[Element]:
    """The children of a document's root one after the other, in bounded memory.

    Each is complete, and is forgotten when the next is asked for.

    Raises:
        InputError: as `parse_xml`, when the place in the file is reached; or another root.
    """
    parser = ElementTree.XMLPullParser(("start", "end"))
    root: Element | None = None
    depth = since_record = tags = 0
    for block in _checked_blocks(path):
        since_record += len(block)
        tags += block.count(b"<")
        if since_record > MAX_RECORD_BYTES or tags > MAX_TAGS:
            raise InputError(
                f"{path}: expected records of at most {MAX_RECORD_BYTES >> 20} MiB and {MAX_TAGS} "
                f"tags in <{root_tag}>, found a larger one; this file is damaged or not of that "
                "format"
            )
        with _told(path):
            parser.feed(block)
            # Faults are kept for the reader of the events.
            events = cast(list[tuple[str, Element]], list(parser.read_events()))
        for event, element in events:
            if event == "start":
                depth += 1
                if root is None:
                    root = element
                    _check_root(path, root.tag, root_tag)
                continue
            depth -= 1
            if depth == 1 and root is not None:
                since_record = tags = 0
                yield element
                root.clear()
    with _told(path):
        parser.close()


def check_xml(path: Path, root_tag: str) -> None:
    """Reads a document through without keeping any of it, for a parser that is less careful.

    Raises:
        InputError: as `iterparse_xml`, but for the size of its records.
    """
    parser = expat.ParserCreate()
    roots: list[str] = []

    def begin(tag: str, _: object) -> None:
        roots.append(tag)
        parser.StartElementHandler = None

    parser.StartElementHandler = begin
    for block in _checked_blocks(path):
        with _told(path):
            parser.Parse(block)
        if roots:
            _check_root(path, roots[0], root_tag)
    with _told(path):
        parser.Parse(b"", True)


def _check_root(path: Path, tag: str, expected: str) -> None:
    if tag != expected:
        raise InputError(
            f"{path}: expected XML of <{expected}>, found <{tag}>; give the right file"
        )


def _checked_blocks(path: Path) -> Iterator[bytes]:
    """The text in blocks, of which none is handed on before a document type would be seen."""
    prolog = _PrologGuard(path)
    try:
        with path.open("rb") as file:
            is_gzip = file.read(2) == _GZIP_MAGIC
            file.seek(0)
            for block in _expanded(path, file) if is_gzip else _plain(file):
                prolog.check(block)
                yield block
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: the gzip stream is damaged or cut off; make it anew") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; correct the path") from error


def _plain(file: BinaryIO) -> Iterator[bytes]:
    while block := file.read(_BLOCK_BYTES):
        yield block


def _expanded(path: Path, file: BinaryIO) -> Iterator[bytes]:
    size = 0
    with gzip.GzipFile(fileobj=file, mode="rb") as stream:
        while block := stream.read(_BLOCK_BYTES):
            size += len(block)
            # file.tell() runs ahead of what was expanded by a small buffer at most.
            if size > RATIO_FROM_BYTES and size > MAX_RATIO * file.tell():
                raise InputError(
                    f"{path}: expected gzip that expands up to {MAX_RATIO} times, found more: "
                    "this looks like a decompression bomb; give the plain file if it is none"
                )
            yield block


class _PrologGuard:
    """Reads along until the root begins: a document type can only come before it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._in_prolog = True
        self._parser = expat.ParserCreate()
        self._parser.StartDoctypeDeclHandler = self._refuse
        self._parser.StartElementHandler = self._leave

    def check(self, block: bytes) -> None:
        if not self._in_prolog:
            return
        with _told(self._path):
            try:
                self._parser.Parse(block)
            except expat.ExpatError:
                # What comes after the root's beginning is told by the parser that reads it all.
                if self._in_prolog:
                    raise

    def _refuse(self, *_: object) -> None:
        raise InputError(
            f"{self._path}: expected XML without a document type, found <!DOCTYPE ...>, which can "
            "define entities; take it out of the file"
        )

    def _leave(self, *_: object) -> None:
        self._in_prolog = False


@contextmanager
def _told(path: Path) -> Generator[None]:
    """What the parsers find wrong, as errors for the user."""
    try:
        yield
    except (expat.ExpatError, ElementTree.ParseError) as error:
        is_expat = isinstance(error, expat.ExpatError)
        line = error.lineno if is_expat else error.position[0]
        raise InputError(
            f"{path}:{line}: not well-formed XML: {error}; correct the file"
        ) from error
    except (ValueError, LookupError) as error:
        raise InputError(
            f"{path}: the encoding that it declares cannot be read: {error}; save it as UTF-8"
        ) from error
