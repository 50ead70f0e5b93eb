"""Types with ranges for the numbers and texts of messages, files and calls.

msgspec checks the ranges when it decodes or converts, and includes them in the JSON Schema. It does not check them when
a struct is built in Python. All ranges are chosen: far beyond the needs of a robot, a floor or a task. They are small
enough that sums, products and conversions to integers stay finite.
"""

from typing import Annotated

from msgspec import Meta

METRES_MAX = 1e6
RADIANS_MAX = 1e6
SECONDS_MAX = 1e9
"""Thirty years."""
PRIORITY_MAX = 1e6
EPOCH_MAX = 2**53 - 1
"""Largest integer that JSON, JavaScript and SQLite all represent exactly."""
STAMP_MAX = 2**62
"""Nanoseconds since 1970: the year 2116."""
NAME_MAX = 128
TEXT_MAX = 4096
REASON_TEXT_MAX = 1024
"""Length of a reason as first given; text that others add may bring it up to `TEXT_MAX`."""

Metres = Annotated[float, Meta(ge=-METRES_MAX, le=METRES_MAX)]
Length = Annotated[float, Meta(ge=0.0, le=METRES_MAX)]
"""Metres, not negative."""
Radians = Annotated[float, Meta(ge=-RADIANS_MAX, le=RADIANS_MAX)]
Speed = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Metres or radians per second."""
Seconds = Annotated[float, Meta(ge=0.0, le=SECONDS_MAX)]
Duration = Annotated[float, Meta(ge=0.0, le=1e6)]
"""Seconds of work at a place: up to eleven days."""
PositiveDuration = Annotated[float, Meta(gt=0.0, le=1e6)]
Joules = Annotated[float, Meta(ge=-1e12, le=1e12)]
Quantity = Annotated[float, Meta(ge=-1e15, le=1e15)]
"""A measured or learned number in any unit, or a variance."""
Watts = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Watts, and coefficients of power."""
INFINITE = "infinite"
"""`Meta(extra={INFINITE: True})`: a number of a `Checked` struct that may be infinite."""
Positive = Annotated[float, Meta(gt=0.0)]
PositiveOrInfinite = Annotated[float, Meta(gt=0.0, extra={INFINITE: True})]
NotNegative = Annotated[float, Meta(ge=0.0)]
NotNegativeOrInfinite = Annotated[float, Meta(ge=0.0, extra={INFINITE: True})]
PositiveInt = Annotated[int, Meta(ge=1)]
NotNegativeInt = Annotated[int, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Charge = Annotated[float, Meta(ge=-1.0, le=2.0)]
"""An estimated state of charge: 0 to 1, with room for an estimate beyond either end."""
Pace = Annotated[float, Meta(ge=1e-3, le=1e6)]
"""A usual speed; above 0 because lengths are divided by it."""
Priority = Annotated[float, Meta(gt=0.0, le=PRIORITY_MAX)]

Count = Annotated[int, Meta(ge=0, le=EPOCH_MAX)]
Epoch = Annotated[int, Meta(ge=0, le=EPOCH_MAX)]
Stamp = Annotated[int, Meta(ge=-STAMP_MAX, le=STAMP_MAX)]
"""Nanoseconds of a clock."""

Name = Annotated[str, Meta(max_length=NAME_MAX)]
"""Name of a robot, mote, plugin, task or person. Names in keys are checked by `check_name` as well."""
KeyName = Annotated[str, Meta(max_length=63, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$(?!\n)")]
"""Name that can be one chunk of a key, as `check_name` checks it."""
Text = Annotated[str, Meta(max_length=TEXT_MAX)]
Names = Annotated[list[Name], Meta(max_length=10_000)]


def cut(text: str, limit: int = REASON_TEXT_MAX) -> str:
    """The text, shortened to `limit` characters; a shortened text ends in `…`.

    >>> cut("much too long", 8)
    'much to…'
    """
    return text if len(text) <= limit else f"{text[: limit - 1]}…"
