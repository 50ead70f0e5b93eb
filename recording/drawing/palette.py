"""Colours and shapes of drawings, distinguishable by colour-blind eyes too.

Robots wear the colours of Okabe and Ito, *Color Universal Design* (2008), without black, which is lost on a dark page.
A robot's shape in the table changes after each round of colours, so that no two of the first 40 are alike.
"""

from typing import NamedTuple

Rgb = tuple[int, int, int]

ROBOT_COLORS: tuple[Rgb, ...] = (
    (230, 159, 0),  # orange
    (86, 180, 233),  # sky blue
    (0, 158, 115),  # bluish green
    (204, 121, 167),  # reddish purple
    (213, 94, 0),  # vermillion
    (240, 228, 66),  # yellow
    (0, 114, 178),  # blue
    (170, 170, 170),  # grey
)
ROBOT_SHAPES = "●▲■◆★"

UNKNOWN: Rgb = (38, 45, 56)
FREE: Rgb = (186, 194, 204)
OCCUPIED: Rgb = (60, 72, 92)
WALL: Rgb = (104, 120, 150)

FRONTIER: Rgb = (255, 214, 10)
NOSE: Rgb = (16, 20, 27)
HALTED: Rgb = (214, 32, 32)
LOST: Rgb = (105, 112, 122)
TRUTH: Rgb = (255, 255, 255)
RELAY: Rgb = (204, 121, 167)
CHARGER: Rgb = (240, 228, 66)
CHARGER_PLATE: Rgb = (24, 96, 160)
TASK_WAITING: Rgb = (240, 240, 240)
HEAT: tuple[Rgb, ...] = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))
"""Five steps of viridis (Smith and van der Walt, 2015), which colour-blind eyes read as the others do."""

GOOD: Rgb = (0, 158, 115)
WARNING: Rgb = (230, 159, 0)
BAD: Rgb = (213, 94, 0)

DOOR: Rgb = (196, 142, 84)
MOVER: Rgb = (122, 134, 156)
PERSON: Rgb = (238, 176, 176)
ROUTE: Rgb = (150, 126, 240)


MOTE_COLORS: tuple[Rgb, ...] = (GOOD, WARNING, BAD, LOST)
"""By `mote_class`."""


class RobotStyle(NamedTuple):
    """Colour and shape of a robot."""

    color: Rgb
    shape: str


def style_of(index: int) -> RobotStyle:
    """The look of the robot that appeared as number `index`, counted from 0."""
    round_number, place = divmod(index, len(ROBOT_COLORS))
    return RobotStyle(ROBOT_COLORS[place], ROBOT_SHAPES[round_number % len(ROBOT_SHAPES)])


def battery_class(soc: float) -> str:
    """Rating of a state of charge, 0 to 1: good, warn or bad."""
    return "good" if soc >= 0.4 else "warn" if soc >= 0.2 else "bad"


def mote_class(voltage_v: float | None) -> int:
    """State of a mote's supply: 0 good, 1 low, 2 nearly empty, 3 never received; its shape follows from it."""
    if voltage_v is None:
        return 3
    return 0 if voltage_v >= 2.7 else 1 if voltage_v >= 2.4 else 2


def mote_color(voltage_v: float | None) -> Rgb:
    """Colour of a mote's supply: two AA cells, whose radio fails below 2.1 V; None is a mote never received."""
    return MOTE_COLORS[mote_class(voltage_v)]


def css(color: Rgb) -> str:
    """The colour as CSS writes it.

    >>> css((230, 159, 0))
    '#e69f00'
    """
    return "#{:02x}{:02x}{:02x}".format(*color)
