"""Who charges where, from when until when: times at chargers, planned ahead for robots that outnumber them.

List scheduling (Graham: Bounds on Multiprocessing Timing Anomalies, SIAM J. Applied Mathematics 17(2), 1969): robots
in one order, each at the charger at which it can begin first. Who stands at a charger comes first, then who goes to one
already, then the others, those with least charge before the rest. Nobody is left out who knows a charger, and nobody
waits for one while another stands empty that it could use.

A charge ends when the battery is full enough. While tasks wait for energy, and behind a robot waits one that is much
lower, it ends at a share that will do for a turn: two robots with half a battery do more than one with a whole. Pure:
equal robots, equal schedule.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from robrain.coordinator.charging.charge_turns import SAME_M
from robrain.protocol.model.geometry import Point2D

DOCK_S = 10.0
"""What docking takes, about, as the robots reckon."""
CLEAR_S = 10.0
"""A robot that leaves a charger is out of the way after so long (chosen: changing places takes some 20 s)."""
TURN_GAIN = 0.15
"""A turn is cut short only for a robot to which it gives so much more of a battery: less is not worth the change."""


class Way(NamedTuple):
    """From a robot to a charger that it knows."""

    charger: Point2D
    way_s: float


class Seeker(NamedTuple):
    """A robot that charges, goes to charge, or should."""

    name: str
    soc: float
    capacity_j: float
    """Its full battery."""
    ways: tuple[Way, ...]
    bound_for: Point2D | None = None
    """The charger that it stands at or goes to already; None if it has yet to be sent."""
    is_there: bool = False
    """It stands at that charger."""
    to_soc: float | None = None
    """What it has set itself, if nobody can tell it otherwise."""
    is_whole: bool = False
    """Its turn is not to be cut short: the last short one was of no use to it."""


class Turn(NamedTuple):
    """A robot's time at a charger, in seconds from now."""

    robot: str
    charger: Point2D
    set_out_s: float
    """When it is to set out, so as to be there when the charger comes free."""
    free_s: float
    """When the charger is free for it."""
    from_s: float
    until_s: float
    to_soc: float
    behind: str = ""
    """The robot that has the charger before it; empty if none has."""


class Demand(NamedTuple):
    """What a charge is to reach."""

    full_soc: float
    turn_soc: float
    """While others wait."""
    is_short: bool
    """Tasks wait for energy."""


def schedule_charges(
    seekers: Iterable[Seeker], demand: Demand, power_w: Callable[[Point2D], float]
) -> tuple[Turn, ...]:
    """The turns of all robots that know a charger, in the order in which they were given out.

    Args:
        seekers: each robot once.
        demand: what a charge is to reach.
        power_w: what a charger puts into a battery, above 0.

    """
    those = sorted((one for one in seekers if one.ways or one.bound_for is not None), key=_order)
    places = _distinct(
        [way.charger for one in those for way in one.ways] + [p for one in those if (p := one.bound_for)]
    )
    likely_soc = demand.turn_soc if demand.is_short and len(those) > len(places) else demand.full_soc
    queues: dict[Point2D, list[tuple[Seeker, float]]] = {place: [] for place in places}
    free_s = dict.fromkeys(places, 0.0)
    given: list[tuple[Point2D, str]] = []
    for one in those:
        place, way_s = _earliest(one, places, free_s)
        until_s = _times(one, way_s, free_s[place], _goal(one, likely_soc), power_w(place))[1]
        queues[place].append((one, way_s))
        free_s[place] = until_s + CLEAR_S
        given.append((place, one.name))
    turns = {}
    for place, queue in queues.items():
        for turn in _turns(place, queue, demand, power_w(place)):
            turns[turn.robot] = turn
    return tuple(turns[name] for _, name in given)


def is_same_charger(one: Point2D, other: Point2D) -> bool:
    """Whether two robots mean one charger: where they believe it to be may differ."""
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) < SAME_M


def _order(one: Seeker) -> tuple[int, float, float, str]:
    if one.is_there:
        return 0, 0.0, one.soc, one.name
    if one.bound_for is not None:
        return 1, _way_to(one, one.bound_for), one.soc, one.name
    return 2, one.soc, 0.0, one.name


def _distinct(found: list[Point2D]) -> list[Point2D]:
    places: list[Point2D] = []
    for place in sorted(found, key=lambda one: (one.x_m, one.y_m)):
        if not any(is_same_charger(place, other) for other in places):
            places.append(place)
    return places


def _way_to(one: Seeker, place: Point2D) -> float:
    ways_s = [way.way_s for way in one.ways if is_same_charger(way.charger, place)]
    return 0.0 if one.is_there else min(ways_s, default=0.0)


def _earliest(one: Seeker, places: Sequence[Point2D], free_s: dict[Point2D, float]) -> tuple[Point2D, float]:
    """The charger at which it can begin first, and the way there; of two alike the nearer one."""
    wanted = [one.bound_for] if one.bound_for is not None else [way.charger for way in one.ways]
    known = [place for place in places if any(is_same_charger(place, other) for other in wanted)]
    ways_s = {place: _way_to(one, place) for place in known}
    place = min(known, key=lambda at: (max(free_s[at], ways_s[at]), ways_s[at], at.x_m, at.y_m))
    return place, ways_s[place]


def _goal(one: Seeker, soc: float) -> float:
    return one.to_soc if one.to_soc is not None else max(soc, one.soc)


def _times(one: Seeker, way_s: float, free_s: float, to_soc: float, power_w: float) -> tuple[float, float]:
    from_s = max(free_s, way_s) if not one.is_there else free_s
    dock_s = 0.0 if one.is_there else DOCK_S
    return from_s, from_s + dock_s + max(0.0, to_soc - one.soc) * one.capacity_j / power_w


def _turns(place: Point2D, queue: list[tuple[Seeker, float]], demand: Demand, power_w: float) -> Iterable[Turn]:
    free_s, behind = 0.0, ""
    for index, (one, way_s) in enumerate(queue):
        needy = [other for other, _ in queue[index + 1 :] if other.soc < demand.turn_soc - TURN_GAIN]
        # What was said to one that has set out is kept to, whatever became of the tasks.
        is_short = needy and (demand.is_short or any(other.bound_for for other in needy)) and not one.is_whole
        to_soc = _goal(one, demand.turn_soc if is_short else demand.full_soc)
        from_s, until_s = _times(one, way_s, free_s, to_soc, power_w)
        yield Turn(one.name, place, max(0.0, from_s - way_s), free_s, from_s, until_s, to_soc, behind)
        free_s, behind = until_s + CLEAR_S, one.name
