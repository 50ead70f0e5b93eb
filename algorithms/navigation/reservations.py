"""Zones that robots reserve: which a path crosses, and whether a robot may drive there.

Each robot publishes its requests, and the latest ones of the robots that it receives. It may drive into a zone once all
robots have received its request. None may have the zone, or have requested it earlier. This is the algorithm of Ricart
and Agrawala (*An Optimal Algorithm for Mutual Exclusion in Computer Networks*, Communications of the ACM 24, 1981).
Each message repeats the whole, so lost messages only delay. Of two robots, one receives the other's request before it
enters. Clocks that differ change only the order.

A silent robot keeps the zones that it last requested. Silent robots without a request do not count while more than half
of the team answers. A robot that answers also reports the requests of robots that others do not receive.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.mapping.zone_grid import cells_in
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.claim import Reservation
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.zone import Zone, ZoneKind

APART_M = 1.0
"""Zones nearer to each other are reserved together (chosen): no robot waits in one of them for the other."""


class ReservedArea:
    """Zones that are reserved together.

    Args:
        zones: reserved zones and doors.

    """

    def __init__(self, zones: Iterable[Zone]) -> None:
        self._zones = sorted(zones, key=lambda zone: zone.name)
        self.names = tuple(zone.name for zone in self._zones)
        self.doors = tuple(zone.name for zone in self._zones if zone.kind is ZoneKind.DOOR)
        """Those that must be open."""
        self.is_exclusive = len(self.doors) < len(self._zones)
        """Whether one robot at a time may drive there; robots share a door otherwise."""

        corners_m = np.concatenate([np.array(zone.corners_m) for zone in self._zones])
        self._low_m, self._high_m = corners_m.min(axis=0), corners_m.max(axis=0)

    def may_meet(self, positions: Floats, reach_m: float) -> bool:
        """Whether any of the positions (N, 2) may be nearer than a distance, by the boxes around both."""
        is_far = (positions.min(axis=0) > self._high_m + reach_m) | (positions.max(axis=0) < self._low_m - reach_m)
        return not is_far.any()

    def distance_m(self, positions: Floats) -> Floats:
        """Distance of positions (N, 2), metres, arena frame, from the area; 0 inside."""
        found: Floats = np.min([distance_m(zone, positions) for zone in self._zones], axis=0)
        return found

    def cells(self, geometry: GridGeometry) -> NDArray[np.bool_]:
        """Mask (H, W) of the cells whose centres are in the area."""
        found: NDArray[np.bool_] = np.logical_or.reduce([cells_in(zone, geometry) for zone in self._zones])
        return found


def reserved_areas(zones: Iterable[Zone]) -> list[ReservedArea]:
    """Reserved zones and doors, with those together that are nearer to each other than `APART_M`."""
    areas: list[list[Zone]] = []
    for zone in zones:
        if zone.is_shut or zone.kind not in (ZoneKind.RESERVED, ZoneKind.DOOR):
            continue
        near = [area for area in areas if any(_gap_m(zone, other) < APART_M for other in area)]
        areas = [area for area in areas if area not in near] + [[zone, *(other for area in near for other in area)]]
    return [ReservedArea(area) for area in areas]


def distance_m(zone: Zone, positions: Floats) -> Floats:
    """Distance of positions (N, 2) from a zone, to the nearest of its sides; 0 inside."""
    begins = np.array(zone.corners_m)
    along = np.roll(begins, -1, axis=0) - begins
    off = positions[:, np.newaxis] - begins
    share = np.clip((off * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
    nearest_m = np.hypot(*(off - share[..., np.newaxis] * along).transpose(2, 0, 1)).min(axis=1)
    inside = [zone.holds(Point2D(x_m, y_m)) for x_m, y_m in positions.tolist()]
    return np.where(inside, 0.0, nearest_m)


def _gap_m(one: Zone, other: Zone) -> float:
    """Distance between two zones, from the corners of each; 0 if a corner is in the other zone."""
    pairs = ((one, other), (other, one))
    return min(float(distance_m(first, np.array(second.corners_m)).min()) for first, second in pairs)


class TeammateRequests(NamedTuple):
    """Another robot's last message about zones."""

    reservations: Sequence[Reservation]
    """Its requests, and those that it knows."""
    is_fresh: bool
    """Whether it is not silent."""


def blockers(own: Reservation, others: Mapping[str, TeammateRequests]) -> list[str]:
    """Robots for which a request waits: those that are there, then those before it in their order, then others.

    None if it is granted.

    Args:
        own: the request.
        others: all robots of the team that are known, by name.

    """
    ahead, unsure, silent = list[tuple[bool, tuple[int, str]]](), list[str](), list[str]()
    for name, other in others.items():
        if not other.is_fresh:
            silent.append(name)
        elif own not in other.reservations:
            unsure.append(name)
        for one in other.reservations:
            if one.robot == own.robot or set(own.zones).isdisjoint(one.zones):
                continue
            known = others.get(one.robot)
            if one.robot == name:
                if one.has or not other.is_fresh or one.rank < own.rank:
                    ahead.append((not one.has, one.rank))
            elif known is None or not known.is_fresh:
                ahead.append((not one.has, one.rank))
    answers = 1 + len(others) - len(silent)
    is_minority = 2 * answers <= 1 + len(others)
    return [*dict.fromkeys(robot for _, (_, robot) in sorted(ahead)), *unsure, *(silent if is_minority else ())]
