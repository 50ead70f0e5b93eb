"""Types with ranges: what a number or a text of a message, a file or a call can be.

msgspec checks them while it decodes or converts, and writes them into the JSON Schema. They are not checked where a
struct is built in Python: code of the project's own keeps to them. All ranges are chosen: far beyond what a robot, a
floor or a task can be, and small enough that sums, products and conversions to integers stay finite.
"""

from typing import Annotated

from msgspec import Meta

METRES_MAX = 1e6
RADIANS_MAX = 1e6
SECONDS_MAX = 1e9
"""Thirty years."""
PRIORITY_MAX = 1e6
EPOCH_MAX = 2**53 - 1
"""JSON, JavaScript and SQLite all hold it."""
STAMP_MAX = 2**62
"""Nanoseconds since 1970: the year 2116."""
NAME_MAX = 128
TEXT_MAX = 4096
WHY_MAX = 1024
"""A reason as its author gives it; others add words to it until it is at most `TEXT_MAX` long."""

Metres = Annotated[float, Meta(ge=-METRES_MAX, le=METRES_MAX)]
Length = Annotated[float, Meta(ge=0.0, le=METRES_MAX)]
"""Metres, not negative."""
Radians = Annotated[float, Meta(ge=-RADIANS_MAX, le=RADIANS_MAX)]
Speed = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Metres or radians a second."""
Seconds = Annotated[float, Meta(ge=0.0, le=SECONDS_MAX)]
Duration = Annotated[float, Meta(ge=0.0, le=1e6)]
"""Seconds that work at a place takes: up to eleven days."""
Joules = Annotated[float, Meta(ge=-1e12, le=1e12)]
Quantity = Annotated[float, Meta(ge=-1e15, le=1e15)]
"""A measured or learned number in whatever unit; a variance."""
Watts = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""And coefficients of power."""
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Charge = Annotated[float, Meta(ge=-1.0, le=2.0)]
"""A state of charge as it is estimated: 0 to 1, and the estimate may pass the ends."""
Pace = Annotated[float, Meta(ge=1e-3, le=1e6)]
"""A usual speed, by which lengths are divided."""
Priority = Annotated[float, Meta(le=PRIORITY_MAX)]
"""A task says itself that it is above 0."""

Count = Annotated[int, Meta(ge=0, le=EPOCH_MAX)]
Epoch = Annotated[int, Meta(ge=0, le=EPOCH_MAX)]
Stamp = Annotated[int, Meta(ge=-STAMP_MAX, le=STAMP_MAX)]
"""Nanoseconds of a clock."""

Name = Annotated[str, Meta(max_length=NAME_MAX)]
"""Of a robot, a mote, a plugin, a task, a person. One that is part of a key is checked there."""
Text = Annotated[str, Meta(max_length=TEXT_MAX)]
Names = Annotated[list[Name], Meta(max_length=10_000)]


def cut(text: str, limit: int = WHY_MAX) -> str:
    """A text that fits: what is longer ends in `…`.

    >>> cut("much too long", 8)
    'much to…'
    """
    return text if len(text) <= limit else f"{text[: limit - 1]}…"
