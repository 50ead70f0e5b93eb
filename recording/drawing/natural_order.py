"""The order in which people expect numbered names."""

import re


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sorts r2 before r10.

    >>> sorted(["r10", "r2"], key=natural_key)
    ['r2', 'r10']
    """
    parts = re.findall(r"\d+|\D", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]
