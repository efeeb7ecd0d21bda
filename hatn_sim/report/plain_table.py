"""How every table of ours looks on a console: a title, no frame, columns some spaces apart."""

from __future__ import annotations

from rich.table import Table


def plain_table(title: str, apart: int = 2) -> Table:
    """A table without columns yet, these being `apart` spaces from each other."""
    return Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=None,
        padding=(0, apart, 0, 0),
        pad_edge=False,
    )
