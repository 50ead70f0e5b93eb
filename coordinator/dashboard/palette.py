"""Colours and shapes of the dashboard, told apart by colour-blind eyes too.

Robots wear the colours of Okabe and Ito, *Color Universal Design* (2008), without black, which is lost on a dark
page. A robot's shape in the table changes after each round of colours, so that no two of the first 40 look alike.
"""

from typing import NamedTuple

from robrain.coordinator.dashboard.team_view import Contact

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

GOOD: Rgb = (0, 158, 115)
WARNING: Rgb = (230, 159, 0)
BAD: Rgb = (213, 94, 0)


class Look(NamedTuple):
    """How a robot is told from others."""

    color: Rgb
    shape: str


def look_of(index: int) -> Look:
    """The look of the robot that appeared as number `index`, counted from 0."""
    round_number, place = divmod(index, len(ROBOT_COLORS))
    return Look(ROBOT_COLORS[place], ROBOT_SHAPES[round_number % len(ROBOT_SHAPES)])


def battery_color(soc: float) -> Rgb:
    """Colour of a state of charge, 0 to 1."""
    return GOOD if soc >= 0.4 else WARNING if soc >= 0.2 else BAD


def mote_color(voltage_v: float | None) -> Rgb:
    """Colour of a mote's supply: two AA cells, whose radio fails below 2.1 V; None is a mote never heard."""
    if voltage_v is None:
        return LOST
    return GOOD if voltage_v >= 2.7 else WARNING if voltage_v >= 2.4 else BAD


def contact_color(contact: Contact) -> Rgb:
    """Colour of how well a robot is heard."""
    return {Contact.UP: GOOD, Contact.SILENT: WARNING, Contact.LOST: BAD}[contact]


def css(color: Rgb) -> str:
    """The colour as CSS writes it.

    >>> css((230, 159, 0))
    '#e69f00'
    """
    return "#{:02x}{:02x}{:02x}".format(*color)
