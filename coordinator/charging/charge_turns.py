"""Chargers assigned in turns, without looking ahead: the baseline of `charge_schedule.py`.

Robots without tasks charge when their battery is low, or when a task is unplanned for lack of energy. The robots with
the lowest charge come first; the others wait where they are. A charger has at most one robot. Pure: depends only on the
present robots and chargers.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from robrain.coordinator.planning.chargers import Charger
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.reasons import PlainReason, plain

SAME_M = 0.6
"""Chargers closer together than this are the same charger; a robot this close to a charger is at it (chosen)."""
TO_SOC = 0.95
"""Target level of a charge that is not cut short."""
FULL_ENOUGH = 0.9
"""A robot above this level is not sent to charge, even if tasks are unplanned."""


class Idle(NamedTuple):
    """A robot without a task."""

    name: str
    place: Point2D
    soc: float
    chargers: tuple[Charger, ...]
    """The chargers that it knows."""


class Charge(NamedTuple):
    """A robot and the charger that it is sent to."""

    robot: str
    charger: Charger
    to_soc: float = TO_SOC


def assign_chargers(
    idle: Sequence[Idle], taken: Iterable[Point2D], below: float
) -> tuple[list[Charge], dict[str, PlainReason]]:
    """Send robots to chargers.

    Args:
        idle: robots without tasks.
        taken: places of chargers at which a robot is, or to which one drives.
        below: state of charge below which a robot charges.

    Returns:
        The assignments, and for each other robot that should charge the reason why it does not.

    """
    used = list(taken)
    charges: list[Charge] = []
    waiting: dict[str, PlainReason] = {}
    for robot in sorted(idle, key=lambda one: (one.soc, one.name)):
        if robot.soc >= below or not robot.chargers:
            continue
        free = [charger for charger in robot.chargers if not any(_near(charger.place, place) for place in used)]
        if not free:
            count = len(robot.chargers)
            text = f"waits for a charger: {count} of {count} are taken"
            waiting[robot.name] = plain("chargers_taken", text, count=count)
            continue
        chosen = min(free, key=lambda charger: _order(robot.place, charger.place))
        used.append(chosen.place)
        charges.append(Charge(robot.name, chosen))
    return charges, waiting


def nearest(place: Point2D, chargers: Sequence[Charger]) -> Point2D | None:
    """The charger nearest to a place by straight line; None if there is none."""
    return min((charger.place for charger in chargers), key=lambda one: _order(place, one), default=None)


def _order(place: Point2D, charger: Point2D) -> tuple[float, float, float]:
    return _away_m(place, charger), charger.x_m, charger.y_m


def _near(one: Point2D, other: Point2D) -> bool:
    return _away_m(one, other) < SAME_M


def _away_m(one: Point2D, other: Point2D) -> float:
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
