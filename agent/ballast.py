"""Lines that nobody needs: they show that `make check` refuses a product above its ceilings."""

LINES = [
    0,
    1,
    2,
    3,
    4,
    5,
    6,
    7,
    8,
    9,
    10,
    11,
    12,
    13,
    14,
    15,
    16,
    17,
    18,
    19,
]
"""For nothing."""
