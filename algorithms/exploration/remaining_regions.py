"""Pure functions that find the regions that exploration leaves on the team's map, each with its reason.

Floor counts as reached if a robot can sweep it from the present place of one of the robots. The sweep uses gaps that
may be wide enough (`clearance.mapped_clearance_m`) and in which no robot has failed. Free floor beyond these gaps
remains, and so does the unknown beyond frontiers that robots reach.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.exploration.narrow_passages import SHUT_RADIUS_M, TRIES, Gap
from robrain.algorithms.navigation.clearance import PREFERRED_MARGIN_M, least_gap_m, mapped_clearance_m
from robrain.algorithms.navigation.frontier import Frontier, find_frontiers, frontier_mask, touching
from robrain.algorithms.navigation.navigation_grid import NavigationGrid, clearance_m
from robrain.algorithms.navigation.path_planning import nearest_traversable
from robrain.protocol.messages.maps.map_messages import REGIONS_MAX, ExplorationLeft, LeftKind, RegionLeft
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

LEAST_AREA_M2 = 0.5
"""Smaller regions are not reported unless a robot fits into them: corners, floor between the legs of furniture."""
SNAP_M = 0.8
"""Greatest distance of a robot from drivable floor, and of a frontier from a place from which it is visible."""
NEAR_M = 0.6
"""A gap, a failure or an earlier place within this distance of a region belongs to it."""
BEYOND_M = 2.0
"""Unknown floor within this distance of a frontier, by rows and columns, belongs to it."""
Cells = NDArray[np.bool_]


class Evidence(NamedTuple):
    """Evidence besides the map; places are in the arena frame."""

    robots: Sequence[Point2D]
    """Places of the robots."""
    radius_m: float
    """The least radius of the robots."""
    gaps: Sequence[Gap] = ()
    """Gaps that robots measured and did not fit through."""
    failures: Sequence[tuple[Point2D, int]] = ()
    """Places that robots failed to get to, with the number of failures."""
    been: Sequence[Point2D] = ()
    """Places where robots were."""
    spent: Sequence[Point2D] = ()
    """Frontiers at which a robot has seen nothing new: not reported."""


def exploration_left(classes: NDArray[np.int8], geometry: GridGeometry, evidence: Evidence) -> ExplorationLeft:
    """All remaining regions; none if no robot's place is known.

    Args:
        classes: (H, W) as of `OccupancyGrid.classes`.
        geometry: of the grid.
        evidence: evidence besides the map.

    """
    found = _Search(classes, geometry, evidence).regions() if evidence.robots else []
    found.sort(key=lambda region: (-region.area_m2, region.place.x_m, region.place.y_m))
    rest = found[REGIONS_MAX:]
    return ExplorationLeft(
        regions=found[:REGIONS_MAX], more=len(rest), more_m2=round(sum(region.area_m2 for region in rest), 2)
    )


class _Search:
    """Analysis of one map, cropped to its known part."""

    def __init__(self, classes: NDArray[np.int8], geometry: GridGeometry, evidence: Evidence) -> None:
        rows, columns = _box_of(classes != UNKNOWN, math.ceil(BEYOND_M / geometry.resolution_m) + 1)
        self.classes = np.ascontiguousarray(classes[rows, columns])
        resolution_m = geometry.resolution_m
        height, width = self.classes.shape
        self.geometry = GridGeometry(
            resolution_m,
            geometry.origin_x_m + columns.start * resolution_m,
            geometry.origin_y_m + rows.start * resolution_m,
            width,
            height,
        )
        self.cell_m2 = resolution_m**2
        self.evidence = evidence
        preferred_m = evidence.radius_m + PREFERRED_MARGIN_M
        needed_m = min(preferred_m, mapped_clearance_m(evidence.radius_m, resolution_m))
        self.navigation = NavigationGrid(self.classes, self.geometry, needed_m, preferred_m=preferred_m)
        self.roamed = self._roamed(self.navigation.without(_shut(evidence.gaps), only_narrow=True))
        swept_m = evidence.radius_m + PREFERRED_MARGIN_M + 0.5 * resolution_m
        self.roomy = self._roomy()
        self.swept = _within(self.roamed, swept_m / resolution_m)
        self.widths = _Gaps(self.classes, self.roomy, resolution_m)

    def regions(self) -> list[RegionLeft]:
        """The regions, in any order."""
        return [*self._seen(), *self._unknown()]

    def _roamed(self, traversable: Cells) -> Cells:
        """The cells to which some robot has a path."""
        labels, _ = touching(traversable)
        snapped = [self.navigation.snap(place, SNAP_M) for place in self.evidence.robots]
        held = {int(labels[cell]) for cell in snapped if cell is not None} - {0}
        roamed: Cells = np.isin(labels, sorted(held))
        return roamed

    def _roomy(self) -> Cells:
        """The cells to which some robot has a path with the preferred clearance; if there are none, `roamed`."""
        labels, _ = touching(self.navigation.traversable & ~self.navigation.narrow)
        reach = max(1, round(SNAP_M / self.geometry.resolution_m))
        cells = [self.geometry.cell_of(place.x_m, place.y_m) for place in self.evidence.robots]
        snapped = [nearest_traversable(labels > 0, cell, reach) for cell in cells]
        held = {int(labels[cell]) for cell in snapped if cell is not None} - {0}
        roomy: Cells = np.isin(labels, sorted(held)) & self.roamed
        return roomy if roomy.any() else self.roamed

    def _seen(self) -> list[RegionLeft]:
        """Floor that was seen and that no robot can get to."""
        left: Cells = (self.classes == FREE) & ~self.swept
        labels, count = touching(left)
        areas_m2 = np.bincount(labels.ravel(), minlength=count + 1) * self.cell_m2
        # A frontier that a robot can reach is not part of an unreachable region.
        edges = frontier_mask(self.classes) & left
        beyond = np.bincount(labels[edges], minlength=count + 1)
        return [
            self._of_seen(labels == label)
            for label in range(1, count + 1)
            if areas_m2[label] >= LEAST_AREA_M2 or (beyond[label] and self._has_room(labels == label))
        ]

    def _has_room(self, region: Cells) -> bool:
        """Whether a robot fits somewhere into a region."""
        return bool((region & self.navigation.traversable).any())

    def _of_seen(self, region: Cells) -> RegionLeft:
        evidence = self.evidence
        tries = max((tries for place, tries in evidence.failures if self._is_near(region, place)), default=0)
        gaps = [gap for gap in evidence.gaps if self._leads_to(region, gap.place)]
        gap_m = gap_at = None
        if any(self._is_in(region, place) for place in evidence.been):
            kind = LeftKind.CUT_OFF
        elif gaps:
            kind = LeftKind.TOO_NARROW
            best = max(gaps, key=lambda gap: gap.gap_m)
            gap_m, gap_at = round(best.gap_m, 3), best.place
        elif tries >= TRIES:
            kind = LeftKind.TRIED
        elif width_m := self.widths.into(region):
            kind, gap_m = LeftKind.TOO_NARROW, round(width_m, 3)
        else:
            kind = LeftKind.UNREACHABLE
        return self._region(region, kind, self.geometry.center_of(*_middle(region)), gap_m, gap_at, tries)

    def _leads_to(self, region: Cells, place: Point2D) -> bool:
        """Whether the path into a region passes the gap in front of which a robot stopped.

        That is so if the region is reached once the gap counts as open: it then joins the floor around the robot.
        """
        here = self.navigation.snap(place, SNAP_M)
        if here is None:
            return False
        shut = _shut([gap for gap in self.evidence.gaps if gap.place != place])
        labels, _ = touching(self.navigation.without(shut, only_narrow=True))
        return bool(((labels == labels[here]) & region).any()) or self._is_near(region, place)

    def _unknown(self) -> list[RegionLeft]:
        """The unknown beyond frontiers that a robot can see."""
        reach = round(BEYOND_M / self.geometry.resolution_m)
        frontiers = [found for found in find_frontiers(self.classes) if self._is_open(found)]
        unknown = np.zeros(self.classes.shape, np.bool_)
        for found in frontiers:
            _mark_beyond(unknown, self.classes, found, reach)
        labels, count = touching(unknown, corners=True)
        areas_m2 = np.bincount(labels.ravel(), minlength=count + 1) * self.cell_m2
        by_region: dict[int, list[Frontier]] = {}
        for found in frontiers:
            by_region.setdefault(_label_beside(labels, found), []).append(found)
        regions = []
        for label in range(1, count + 1):
            edge = by_region.get(label)
            if edge is None or areas_m2[label] < LEAST_AREA_M2:
                continue
            longest = max(edge, key=lambda found: (found.cells, -found.row, -found.column))
            place = self.geometry.center_of(longest.row, longest.column)
            places = [self.geometry.center_of(found.row, found.column) for found in edge]
            near = [tries for failed, tries in self.evidence.failures if min(map(failed.distance_m, places)) < NEAR_M]
            tries = max(near, default=0)
            gap_m = gap_at = None
            if (gap := self._gap_before(edge)) is not None:
                kind, gap_m, gap_at = LeftKind.TOO_NARROW, round(gap.gap_m, 3), gap.place
            elif tries >= TRIES:
                kind = LeftKind.TRIED
            else:
                kind, gap_m = LeftKind.UNSEEN, self._narrowest_m(edge)
            regions.append(self._region(labels == label, kind, place, gap_m, gap_at, tries))
        return regions

    def _is_open(self, found: Frontier) -> bool:
        place = self.geometry.center_of(found.row, found.column)
        reach = self.navigation.geometry.resolution_m
        if any(place.distance_m(spent) < reach for spent in self.evidence.spent):
            return False
        return self._is_within(self.roamed, found)

    def _gap_before(self, edge: Sequence[Frontier]) -> Gap | None:
        """The gap that a robot measured and that every path to these frontiers passes; None if there is none."""
        for gap in self.evidence.gaps:
            circle = (gap.place.x_m, gap.place.y_m, SHUT_RADIUS_M)
            roamed = self._roamed(self.navigation.without([circle], only_narrow=True))
            if not any(self._is_within(roamed, found) for found in edge):
                return gap
        return None

    def _is_within(self, roamed: Cells, found: Frontier) -> bool:
        """Whether a robot on the cells of `roamed` can see a frontier."""
        cell = self.navigation.snap(self.geometry.center_of(found.row, found.column), SNAP_M)
        return cell is not None and bool(roamed[cell])

    def _narrowest_m(self, edge: Sequence[Frontier]) -> float | None:
        """Width of the gap on the widest path to these frontiers, metres; None if a path has room to spare."""
        reach = round(SNAP_M / self.geometry.resolution_m)
        places = np.zeros(self.classes.shape, np.bool_)
        for found in edge:
            if nearest_traversable(self.roomy, (found.row, found.column), reach) is not None:
                return None
            cell = nearest_traversable(self.roamed, (found.row, found.column), reach)
            if cell is not None:
                places[cell] = True
        width_m = self.widths.into(places)
        return None if width_m is None else round(width_m, 3)

    def _region(
        self, region: Cells, kind: LeftKind, place: Point2D, gap_m: float | None, gap_at: Point2D | None, tries: int
    ) -> RegionLeft:
        rows, columns = _box_of(region, 0)
        geometry, half_m = self.geometry, 0.5 * self.geometry.resolution_m
        low = geometry.center_of(rows.start, columns.start)
        high = geometry.center_of(rows.stop - 1, columns.stop - 1)
        return RegionLeft(
            kind=kind,
            place=_rounded(place),
            area_m2=round(int(np.count_nonzero(region)) * self.cell_m2, 2),
            low=_rounded(Point2D(low.x_m - half_m, low.y_m - half_m)),
            high=_rounded(Point2D(high.x_m + half_m, high.y_m + half_m)),
            gap_m=gap_m,
            gap_at=None if gap_at is None else _rounded(gap_at),
            needed_m=None if gap_m is None else round(least_gap_m(self.evidence.radius_m), 3),
            tries=tries,
        )

    def _is_near(self, region: Cells, place: Point2D) -> bool:
        return self._is_in(region, place, round(NEAR_M / self.geometry.resolution_m))

    def _is_in(self, region: Cells, place: Point2D, reach: int = 1) -> bool:
        row, column = self.geometry.cell_of(place.x_m, place.y_m)
        box = np.s_[max(row - reach, 0) : max(row + reach + 1, 0), max(column - reach, 0) : max(column + reach + 1, 0)]
        return bool(region[box].any())


class _Gaps:
    """Width of the widest path from the robots' floor to other free floor.

    Distances are measured on a lattice of half a cell. The middle of a gap of an even number of cells is then a point
    of the lattice. A gap between walls that leaves `n` cells free has a width of `n` to `n + 2` cells.
    """

    def __init__(self, classes: NDArray[np.int8], roomy: Cells, resolution_m: float) -> None:
        self._resolution_m = resolution_m
        self._wall = _on_lattice(classes == OCCUPIED, any_of=True)
        self._free = _on_lattice(classes == FREE, any_of=False) & ~self._wall
        self._roomy = _on_lattice(roomy, any_of=False)
        self._labels: dict[int, NDArray[np.int32]] = {}
        self._depth: NDArray[np.int64] | None = None

    def into(self, region: Cells) -> float | None:
        """Width of the narrowest gap on the widest path into a region, metres; None if no path is free."""
        if self._depth is None:
            # The squared clearance in half cells is a whole number.
            limit = 1e6
            self._depth = np.rint(clearance_m(self._wall, 1.0, limit).astype(np.float64) ** 2).astype(np.int64)
        inside = _on_lattice(region, any_of=False) & self._free
        depths = np.unique(self._depth[self._free])
        low, high = 0, len(depths) - 1
        if high < 0 or not self._joins(int(depths[0]), inside):
            return None
        while low < high:  # the widest clearance at which both are joined
            middle = (low + high + 1) // 2
            low, high = (middle, high) if self._joins(int(depths[middle]), inside) else (low, middle - 1)
        return (math.sqrt(float(depths[low])) + 1.0) * self._resolution_m

    def _joins(self, depth: int, inside: Cells) -> bool:
        assert self._depth is not None
        labels = self._labels.get(depth)
        if labels is None:
            labels, _ = touching(self._free & (self._depth >= depth))
            self._labels[depth] = labels
        held = np.unique(labels[self._roomy])
        return bool(np.isin(labels[inside], held[held > 0]).any())


def _shut(gaps: Sequence[Gap]) -> list[tuple[float, float, float]]:
    """Circles (x, y, radius in metres) through whose narrow places no robot is sent any more."""
    return [(gap.place.x_m, gap.place.y_m, SHUT_RADIUS_M) for gap in gaps if gap.tries >= TRIES]


def _on_lattice(cells: Cells, *, any_of: bool) -> Cells:
    """Cells (H, W) as points (2 H + 1, 2 W + 1): middles, edges and corners of the cells.

    An edge or a corner is marked if any of the cells at it is, or with `any_of=False` if one of the unmarked is not.
    """
    height, width = cells.shape
    counted = cells if any_of else ~cells
    points = np.zeros((2 * height + 1, 2 * width + 1), np.bool_)
    for row in range(3):
        for column in range(3):
            points[row : row + 2 * height : 2, column : column + 2 * width : 2] |= counted
    return points if any_of else ~points


def _within(cells: Cells, reach_cells: float) -> Cells:
    """The cells whose middle is within `reach_cells` of that of one of these."""
    pad = math.ceil(reach_cells) + 2  # beyond the grid counts as marked
    padded = np.pad(cells, pad)
    near = clearance_m(padded, 1.0, reach_cells + 1.0)[pad:-pad, pad:-pad] <= np.float32(reach_cells)
    return np.ascontiguousarray(near)


def _mark_beyond(unknown: Cells, classes: NDArray[np.int8], found: Frontier, reach: int) -> None:
    """Mark the unknown cells within reach of a frontier that no known wall separates from it."""
    top, left = max(found.row - reach, 0), max(found.column - reach, 0)
    box = np.s_[top : found.row + reach + 1, left : found.column + reach + 1]
    labels, _ = touching(classes[box] != OCCUPIED)
    here = labels[found.row - top, found.column - left]
    unknown[box] |= (labels == here) & (classes[box] == UNKNOWN)


def _label_beside(labels: NDArray[np.int32], found: Frontier) -> int:
    """The region of a frontier cell: that of the unknown cell beside it; 0 if there is none."""
    for row, column in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        near_row, near_column = found.row + row, found.column + column
        if 0 <= near_row < labels.shape[0] and 0 <= near_column < labels.shape[1] and labels[near_row, near_column]:
            return int(labels[near_row, near_column])
    return 0


def _middle(region: Cells) -> tuple[int, int]:
    """The cell (row, column) of a region that is farthest from its edge."""
    rows, columns = _box_of(region, 0)
    depth = clearance_m(~np.pad(region[rows, columns], 1), 1.0, 1e6)[1:-1, 1:-1]
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return rows.start + int(row), columns.start + int(column)


def _box_of(cells: Cells, margin: int) -> tuple[slice, slice]:
    """Rows and columns of the smallest box around the marked cells and a margin; an empty grid is kept as it is."""
    height, width = cells.shape
    rows, columns = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    if rows.size == 0:
        return slice(0, height), slice(0, width)
    return (
        slice(max(int(rows[0]) - margin, 0), min(int(rows[-1]) + margin + 1, height)),
        slice(max(int(columns[0]) - margin, 0), min(int(columns[-1]) + margin + 1, width)),
    )


def _rounded(place: Point2D) -> Point2D:
    return Point2D(round(place.x_m, 3), round(place.y_m, 3))
