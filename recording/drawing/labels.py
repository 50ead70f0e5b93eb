"""Names and durations as people expect them."""

import re


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sorts r2 before r10.

    >>> sorted(["r10", "r2"], key=natural_key)
    ['r2', 'r10']
    """
    parts = re.findall(r"\d+|\D", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def span_text(time_s: float) -> str:
    """A duration in s, min or h.

    >>> span_text(42.0), span_text(500.0), span_text(9000.0)
    ('42 s', '8 min', '2.5 h')
    """
    if time_s < 100:
        return f"{time_s:.0f} s"
    return f"{time_s / 60:.0f} min" if time_s < 5400 else f"{min(time_s / 3600, 9999):.1f} h"
