import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from robrain.protocol.model.geometry import Point2D
from robrain.sim.maps.floor_plan import FloorPlan

grids = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12))


def _plan(drawn: str, resolution_m: float = 1.0) -> FloorPlan:
    """A plan from lines of text, the top line being the highest y: # is wall."""
    rows = [[cell == "#" for cell in line] for line in drawn.split()]
    return FloorPlan(np.flipud(np.array(rows)), resolution_m, 0.0, 0.0, "drawn")


def _gap_to_walls_m(plan: FloorPlan, row: int, col: int) -> float:
    """Distance from a cell's centre to the nearest wall square or to the grid's edge, found the slow way."""
    rows, cols = plan.occupied.shape
    gap = min(row + 0.5, rows - row - 0.5, col + 0.5, cols - col - 0.5)
    for wall_row, wall_col in np.argwhere(plan.occupied):
        across = max(abs(int(wall_row) - row) - 0.5, 0.0)
        along = max(abs(int(wall_col) - col) - 0.5, 0.0)
        gap = min(gap, float(np.hypot(across, along)))
    return gap * plan.resolution_m


@pytest.mark.slow
@given(grids)
def test_clearance_is_the_exact_distance_to_the_nearest_wall_square(occupied: np.ndarray) -> None:
    plan = FloorPlan(occupied, 0.25, 0.0, 0.0, "random")
    for row, col in np.ndindex(occupied.shape):
        assert plan.clearance_m[row, col] == pytest.approx(_gap_to_walls_m(plan, row, col))


@given(grids, st.floats(0, 3), st.tuples(st.floats(0, 12), st.floats(0, 12)))
def test_reachable_cells_are_free_and_shrink_as_the_body_grows(
    occupied: np.ndarray, radius_m: float, start: tuple[float, float]
) -> None:
    plan = FloorPlan(occupied, 1.0, 0.0, 0.0, "random")
    swept = plan.reachable([Point2D(*start)], radius_m)
    assert not (swept & plan.occupied).any()
    if swept.any():
        row, col = plan.geometry.cell_of(*start)
        assert swept[row, col]
        assert plan.clearance_m[row, col] >= radius_m


def test_body_does_not_pass_a_door_narrower_than_itself() -> None:
    plan = _plan(
        """
        .....#.....
        .....#.....
        ...........
        .....#.....
        .....#.....
        """
    )
    start = [Point2D(1.5, 2.5)]
    assert plan.reachable(start, 0.5)[:, 6:].any()
    assert not plan.reachable(start, 0.6)[:, 6:].any()


def test_body_does_not_slip_between_walls_that_touch_at_a_corner() -> None:
    plan = _plan(
        """
        ..#
        ##.
        ...
        """
    )
    assert plan.reachable([Point2D(0.5, 2.5)], 0.0).tolist() == [[False] * 3, [False] * 3, [True, True, False]]


def test_start_where_the_body_does_not_fit_adds_nothing() -> None:
    plan = _plan("....\n....\n....\n....")
    for start in (Point2D(0.1, 0.1), Point2D(-3.0, 2.0), Point2D(2.0, 40.0)):
        assert not plan.reachable([start], 1.0).any()
    assert plan.reachable([Point2D(0.1, 0.1), Point2D(2.1, 2.1)], 1.0).any()


def test_points_map_to_cells_from_the_origin() -> None:
    plan = FloorPlan(np.array([[False, True], [False, False], [True, False]]), 0.5, -1.0, 2.0, "tiny")
    assert plan.size_m == (1.0, 1.5)
    assert plan.geometry.cell_of(-1.0, 2.0) == (0, 0)
    assert plan.geometry.cell_of(-0.4, 3.4) == (2, 1)
    assert plan.geometry.center_of(2, 1) == Point2D(-0.25, 3.25)
    assert plan.contains_free(-0.9, 2.1)
    assert not plan.contains_free(-0.4, 2.1)


@pytest.mark.parametrize("point", [(-1.01, 2.1), (0.01, 2.6), (-0.9, 1.99), (-0.9, 3.51)])
def test_outside_the_grid_is_wall(point: tuple[float, float]) -> None:
    plan = FloorPlan(np.zeros((3, 2), dtype=bool), 0.5, -1.0, 2.0, "tiny")
    assert not plan.contains_free(*point)
