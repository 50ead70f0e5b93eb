"""Who is to charge, and at which charger, in turns: never two robots at one.

Robots without tasks charge when they have little left, or when a task is left out for want of energy; those with least
come first, the others wait for their turn where they are. Pure: of the robots and chargers as they are now. It is what
`charge_schedule.py`, which looks ahead, is compared with.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from robrain.coordinator.charging.chargers import Charger
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.reasons.plans import ChargersTaken

SAME_M = 0.6
"""Chargers nearer to each other than this are one to two robots; a robot so near to one is at it (chosen)."""
TO_SOC = 0.95
"""What a charge is for that nothing cuts short."""
FULL_ENOUGH = 0.9
"""A robot with so much charge does not go for more, whatever is left out."""


class Idle(NamedTuple):
    """A robot that has nothing to do."""

    name: str
    place: Point2D
    soc: float
    chargers: tuple[Charger, ...]
    """Those that it knows."""


class Charge(NamedTuple):
    """A robot and the charger that it is to go to."""

    robot: str
    charger: Charger
    to_soc: float = TO_SOC


def assign_chargers(
    idle: Sequence[Idle], taken: Iterable[Point2D], below: float
) -> tuple[list[Charge], dict[str, ChargersTaken]]:
    """Send robots to chargers.

    Args:
        idle: robots without tasks.
        taken: places of chargers at which a robot is, or to which one goes.
        below: state of charge below which a robot charges.

    Returns:
        Who goes where, and why each other robot that should charge does not.

    """
    used = list(taken)
    charges: list[Charge] = []
    waiting: dict[str, ChargersTaken] = {}
    for robot in sorted(idle, key=lambda one: (one.soc, one.name)):
        if robot.soc >= below or not robot.chargers:
            continue
        free = [charger for charger in robot.chargers if not any(_near(charger.place, place) for place in used)]
        if not free:
            waiting[robot.name] = ChargersTaken(len(robot.chargers))
            continue
        chosen = min(free, key=lambda charger: _order(robot.place, charger.place))
        used.append(chosen.place)
        charges.append(Charge(robot.name, chosen))
    return charges, waiting


def nearest(place: Point2D, chargers: Sequence[Charger]) -> Point2D | None:
    """The charger nearest to a place, as the crow flies; None if there is none."""
    return min((charger.place for charger in chargers), key=lambda one: _order(place, one), default=None)


def _order(place: Point2D, charger: Point2D) -> tuple[float, float, float]:
    return _away_m(place, charger), charger.x_m, charger.y_m


def _near(one: Point2D, other: Point2D) -> bool:
    return _away_m(one, other) < SAME_M


def _away_m(one: Point2D, other: Point2D) -> float:
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
