"""The schedule of chargers: which robot charges where, from when until when.

List scheduling (Graham: Bounds on Multiprocessing Timing Anomalies, SIAM J. Applied Mathematics 17(2), 1969): in turn
each robot gets the charger at which it can begin first. First come the robots at chargers, then those that drive to
one, then the others, lowest charge first. Every robot that knows a charger gets a turn, and no robot waits while a
charger that it could use is free.

A charge ends when the battery is full enough. While tasks wait for a robot's charge, it ends as soon as there is enough
for them. Pure: equal robots give an equal schedule.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from robrain.coordinator.planning.energy_budget import CHARGED_SOC, DOCK_S
from robrain.coordinator.team.chargers import is_same_charger
from robrain.protocol.model.geometry import Point2D

CLEAR_S = 10.0
"""Time until a robot that leaves a charger is out of the path (chosen: changing places takes some 20 s)."""


class ChargerPath(NamedTuple):
    """The path from a robot to a charger that it knows."""

    charger: Point2D
    travel_s: float


class ChargeSeeker(NamedTuple):
    """A robot that charges, drives to a charger, or should charge."""

    name: str
    soc: float
    capacity_j: float
    """Full battery."""
    paths: tuple[ChargerPath, ...]
    bound_for: Point2D | None = None
    """The charger that it stands at or drives to; None if it has not been sent yet."""
    is_there: bool = False
    """Whether it stands at that charger."""
    to_soc: float | None = None
    """Level that the robot has set for itself; None if the coordinator decides."""
    is_whole: bool = False
    """Whether its charge must not end early, because it made no use of the last one that did."""
    needs_soc: float | None = None
    """Level that is enough for the tasks that wait for its charge; None if none do."""


class ChargerSlot(NamedTuple):
    """A robot's time at a charger, in seconds from now."""

    robot: str
    charger: Point2D
    set_out_s: float
    """When it must set out to arrive as the charger becomes free."""
    free_s: float
    """When the charger is free for it."""
    from_s: float
    until_s: float
    to_soc: float
    behind: str = ""
    """The robot that has the charger before it; empty if there is none."""


def schedule_charges(seekers: Iterable[ChargeSeeker], power_w: Callable[[Point2D], float]) -> tuple[ChargerSlot, ...]:
    """Return the turns of all robots that know a charger, in the order in which they were assigned.

    Args:
        seekers: the robots, each once.
        power_w: power of a charger into the battery, above 0.

    """
    served = sorted((one for one in seekers if one.paths or one.bound_for is not None), key=_order)
    places = _distinct(
        [path.charger for one in served for path in one.paths] + [p for one in served if (p := one.bound_for)]
    )
    full_s, free_s = dict.fromkeys(places, 0.0), dict.fromkeys(places, 0.0)
    """When each charger is free: if no charge ends early, by which chargers are assigned, and by the schedule."""
    behind = dict.fromkeys(places, "")
    turns = []
    for one in served:
        place, travel_s = _earliest(one, places, full_s)
        level_soc, charger_w = CHARGED_SOC, power_w(place)
        full_s[place] = _times(one, travel_s, full_s[place], _goal(one, level_soc), charger_w)[1] + CLEAR_S
        if one.is_there and one.needs_soc is not None and not one.is_whole:
            level_soc = min(level_soc, one.needs_soc)
        to_soc = _goal(one, level_soc)
        from_s, until_s = _times(one, travel_s, free_s[place], to_soc, charger_w)
        set_out_s = max(0.0, from_s - travel_s)
        turns.append(ChargerSlot(one.name, place, set_out_s, free_s[place], from_s, until_s, to_soc, behind[place]))
        free_s[place], behind[place] = until_s + CLEAR_S, one.name
    return tuple(turns)


def _order(one: ChargeSeeker) -> tuple[int, float, float, str]:
    if one.is_there:
        return 0, 0.0, one.soc, one.name
    if one.bound_for is not None:
        return 1, _path_to(one, one.bound_for), one.soc, one.name
    return 2, one.soc, 0.0, one.name


def _distinct(found: list[Point2D]) -> list[Point2D]:
    places: list[Point2D] = []
    for place in sorted(found, key=lambda one: (one.x_m, one.y_m)):
        if not any(is_same_charger(place, other) for other in places):
            places.append(place)
    return places


def _path_to(one: ChargeSeeker, place: Point2D) -> float:
    paths_s = [path.travel_s for path in one.paths if is_same_charger(path.charger, place)]
    return 0.0 if one.is_there else min(paths_s, default=0.0)


def _earliest(one: ChargeSeeker, places: Sequence[Point2D], free_s: dict[Point2D, float]) -> tuple[Point2D, float]:
    """The charger at which the robot can begin first, and its path length; of two equal ones the nearer."""
    wanted = [one.bound_for] if one.bound_for is not None else [path.charger for path in one.paths]
    known = [place for place in places if any(is_same_charger(place, other) for other in wanted)]
    paths_s = {place: _path_to(one, place) for place in known}
    place = min(known, key=lambda at: (max(free_s[at], paths_s[at]), paths_s[at], at.x_m, at.y_m))
    return place, paths_s[place]


def _goal(one: ChargeSeeker, soc: float) -> float:
    return one.to_soc if one.to_soc is not None else max(soc, one.soc)


def _times(one: ChargeSeeker, travel_s: float, free_s: float, to_soc: float, power_w: float) -> tuple[float, float]:
    from_s = max(free_s, travel_s) if not one.is_there else free_s
    dock_s = 0.0 if one.is_there else DOCK_S
    return from_s, from_s + dock_s + max(0.0, to_soc - one.soc) * one.capacity_j / power_w
