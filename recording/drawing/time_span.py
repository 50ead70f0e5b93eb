"""Durations for people."""


def span_text(time_s: float, longest_s: float = 0.0) -> str:
    """A duration in s, min or h; in the unit of the longest one, for tables.

    >>> span_text(42.0), span_text(500.0), span_text(9000.0), span_text(500.0, 9000.0)
    ('42 s', '8 min', '2.5 h', '0.1 h')
    """
    longest_s = max(time_s, longest_s)
    if longest_s < 100:
        return f"{time_s:.0f} s"
    return f"{time_s / 60:.0f} min" if longest_s < 6000 else f"{min(time_s / 3600, 9999):.1f} h"
