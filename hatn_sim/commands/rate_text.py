"""How a rate is written: with two digits that say something."""

from __future__ import annotations


def rate_text(rate: float) -> str:
    """Of a rate of at least 0.

    >>> [rate_text(rate) for rate in (0.0, 0.0437, 0.5, 2.04, 37.6, 1200.0)]
    ['0', '0.044', '0.5', '2.0', '38', '1200']
    """
    if rate >= 10.0:
        return f"{rate:.0f}"
    return f"{rate:.1f}" if rate >= 1.0 else f"{rate:.2g}"
