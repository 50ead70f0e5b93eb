"""Referee and planner agree on what fits: floor plans with one gap, of all widths, angles and offsets from the grid.

The referee judges the floor plan, robots plan on the team's map. Floor that the referee counts must never lie behind a
gap that no robot would try; and what a robot tries without success must look on the map like a gap that is wide enough.
"""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from robrain.algorithms.navigation.clearance import least_clearance_m, least_gap_m, mapped_clearance_m, mapped_gap_cells
from robrain.algorithms.navigation.frontier import touching
from robrain.algorithms.navigation.navigation_grid import NavigationGrid
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.world.referee import floor_weights, team_geometry

SIDE_M = 3.6
RADII_M = (0.2, 0.25)
WIDTHS_CM = range(34, 74, 2)
THICK_M = (0.1, 1.0)
OFFSETS_M = ((0.0, 0.0), (0.03, 0.07))
"""Of the gap's middle from that of the floor: to the team's grid of 0.1 m."""
PLAN_M = 0.02
"""Pitch of the floor plan: fine, so that a gap's width is that of the drawing."""
TEAM_M = 0.1


class Gap:
    """A square floor with a wall across it at an angle, and a gap in the wall."""

    def __init__(self, width_m: float, angle_rad: float, offset_m: tuple[float, float], thick_m: float) -> None:
        cells = round(SIDE_M / PLAN_M)
        middles = (np.arange(cells) + 0.5) * PLAN_M
        x_m, y_m = np.meshgrid(middles - SIDE_M / 2 - offset_m[0], middles - SIDE_M / 2 - offset_m[1])
        through_m = x_m * math.cos(angle_rad) + y_m * math.sin(angle_rad)
        along_m = y_m * math.cos(angle_rad) - x_m * math.sin(angle_rad)
        occupied = (np.abs(through_m) <= thick_m / 2) & (np.abs(along_m) >= width_m / 2)
        occupied[[0, -1]] = occupied[:, [0, -1]] = True
        self.plan = FloorPlan(occupied, PLAN_M, 0.0, 0.0, "gap")
        x_m, y_m = SIDE_M / 2 + offset_m[0], SIDE_M / 2 + offset_m[1]
        self.here, self.there = (
            Point2D(x_m + 1.1 * side * math.cos(angle_rad), y_m + 1.1 * side * math.sin(angle_rad)) for side in (-1, 1)
        )

    def is_counted(self, radius_m: float) -> bool:
        """Whether the referee counts the floor behind the gap."""
        geometry = team_geometry(self.plan)
        weights = floor_weights(self.plan, [self.here], least_clearance_m(radius_m), geometry)
        return bool(weights[geometry.cell_of(self.there.x_m, self.there.y_m)])

    def is_tried(self, radius_m: float) -> bool:
        """Whether a robot plans through the gap on a map in which each cell that holds a piece of wall is occupied."""
        geometry = team_geometry(self.plan)
        classes = np.full(geometry.shape, FREE, np.int8)
        classes[self._cells(geometry.origin_x_m, geometry.origin_y_m)] = OCCUPIED
        grid = NavigationGrid(classes, geometry, mapped_clearance_m(radius_m, TEAM_M))
        labels, _ = touching(grid.traversable)
        here, there = grid.snap(self.here, 0.3), grid.snap(self.there, 0.3)
        assert here is not None
        assert there is not None
        return bool(labels[here] == labels[there])

    def _cells(self, origin_x_m: float, origin_y_m: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        rows, columns = np.nonzero(self.plan.occupied)
        return (
            np.floor(((rows + 0.5) * PLAN_M - origin_y_m) / TEAM_M + 1e-9).astype(np.int64),
            np.floor(((columns + 0.5) * PLAN_M - origin_x_m) / TEAM_M + 1e-9).astype(np.int64),
        )


def gaps(angle_deg: int) -> Iterator[tuple[float, Gap]]:
    for width_cm in WIDTHS_CM:
        for thick_m in THICK_M:
            for offset_m in OFFSETS_M:
                yield width_cm / 100, Gap(width_cm / 100, math.radians(angle_deg), offset_m, thick_m)


@pytest.mark.slow
@pytest.mark.parametrize("angle_deg", [0, 30, 45])
def test_floor_is_counted_only_behind_gaps_that_robots_try_and_what_is_tried_is_nearly_wide_enough(
    angle_deg: int,
) -> None:
    for width_m, gap in gaps(angle_deg):
        for radius_m in RADII_M:
            needed_m = least_gap_m(radius_m)
            is_counted, is_tried = gap.is_counted(radius_m), gap.is_tried(radius_m)
            said = f"radius {radius_m}, gap of {width_m:.2f} m: counted {is_counted}, tried {is_tried}"
            assert is_tried or not is_counted, said
            # Drawn on cells of 0.02 m, a gap may be narrower than it is by two of them and by a corner of one.
            assert is_counted or width_m < needed_m + 3 * PLAN_M, said
            assert not is_counted or width_m >= needed_m - PLAN_M, said
            assert not is_tried or width_m > (_least_tried(radius_m) - 0.01) * TEAM_M, said


@pytest.mark.parametrize("radius_m", [0.15, 0.2, 0.25, 0.3])
def test_a_gap_that_is_tried_in_vain_looks_on_the_map_like_one_that_is_wide_enough_or_is_a_cell_narrower(
    radius_m: float,
) -> None:
    """Nothing that only sees which cells are occupied can refuse the one and try the other.

    Paths lead over the middles of cells, which leave as much room in a gap of 3 cells as in one of 4: where the
    narrowest passable gap shows an even number of cells, one cell less is tried as well.
    """
    needed_m, offsets_m = least_gap_m(radius_m), [k / 200 for k in range(20)]
    least = min(_free_cells(needed_m, offset_m) for offset_m in offsets_m)
    assert least == mapped_gap_cells(radius_m, TEAM_M)
    for width_cm in range(10, round(100 * needed_m)):
        for offset_m in offsets_m:
            free = _free_cells(width_cm / 100, offset_m)
            assert _is_tried(free, radius_m) == (free >= _least_tried(radius_m)), f"{width_cm} cm, {free} free cells"


def _least_tried(radius_m: float) -> int:
    """The least number of free cells of a gap that is tried."""
    least = mapped_gap_cells(radius_m, TEAM_M)
    return least - (least + 1) % 2


def _free_cells(width_m: float, offset_m: float) -> int:
    """Whole free cells between walls along the axes of the map."""
    return math.floor((offset_m + width_m) / TEAM_M + 1e-9) - (math.floor(offset_m / TEAM_M + 1e-9) + 1)


def _is_tried(free: int, radius_m: float) -> bool:
    classes = np.full((40, 40), OCCUPIED, np.int8)
    classes[10 : 10 + max(free, 0), 1:-1] = FREE
    grid = NavigationGrid(classes, team_geometry(_EMPTY), mapped_clearance_m(radius_m, TEAM_M))
    return bool(grid.traversable[:, 20].any())


_EMPTY = FloorPlan(np.zeros((34, 34), np.bool_), TEAM_M, 0.0, 0.0, "empty")
"""Whose team's grid has 40 × 40 cells."""
