import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.mapping.local_map import NO_DRIFT, Drift
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.submap import PARTS, SURFACE
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper.own_submaps import OwnSubmaps, SubmapSpec
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED
from tests.algorithms.mapping.lidar_floor import ANGLES_RAD, GEOMETRY, NOBODY, RANGE_M, ROOM, ROOM_PLACES

PRIOR = np.diag((0.04, 0.03, 0.01))
START = Pose2D(1.0, 3.1, 0.3)


def mapper(**spec: float) -> OwnSubmaps:
    return OwnSubmaps(GEOMETRY, SubmapGraph("r1", GraphSpec()), SubmapSpec(**spec))


def begun(number: int = 5, **spec: float) -> OwnSubmaps:
    own = mapper(**spec)
    own.begin_submap(number, START, NO_DRIFT, PRIOR)
    return own


def scan(own: OwnSubmaps, sensor: Pose2D, *, drift: Drift = NO_DRIFT, ignore: np.ndarray = NOBODY) -> None:
    own.integrate(sensor, ANGLES_RAD, ROOM.ranges_m(sensor), RANGE_M, 7, ignore, drift)


def test_before_the_first_scan_there_is_no_map_and_a_submap_is_due() -> None:
    own = mapper()
    assert own.is_over()
    assert own.number is None
    assert own.local_map() is None
    assert own.pop_patch() is None


def test_a_submap_tells_what_localisation_is_to_go_by() -> None:
    own = mapper()
    own.T_arena_local = Pose2D(1.0, 0.0, 0.2)
    own.begin_trajectory(3)
    own.begin_submap(5, START, (0.02, 0.001), PRIOR)
    local = own.local_map()
    assert local is not None
    assert local.grid is own.grid
    assert (local.T_arena_local, local.anchor) == (Pose2D(1.0, 0.0, 0.2), START)
    assert local.variances == pytest.approx((0.04, 0.03, 0.01))
    assert local.drift == (0.02, 0.001)
    assert (local.number, local.oldest, local.trajectory) == (5, 5, 3)
    assert own.number == 5


def test_numbers_grow_even_if_two_submaps_begin_at_the_same_time() -> None:
    own = begun(5)
    own.begin_submap(5, START, NO_DRIFT, PRIOR)
    assert own.number == 6
    own.begin_submap(9, START, NO_DRIFT, PRIOR)
    assert own.number == 9


def test_the_first_submap_is_as_unsure_as_the_robot_and_the_next_one_by_what_it_drifted_more() -> None:
    own = mapper()
    own.begin_submap(5, START, (0.01, 0.001), PRIOR)
    node = own.graph.current
    assert node is not None
    assert node.covariance == pytest.approx(PRIOR)
    own.begin_submap(6, START, (0.05, 0.003), PRIOR)
    node = own.graph.current
    assert node is not None
    assert np.diag(node.covariance) == pytest.approx((0.08, 0.07, 0.012), abs=2e-6)
    local = own.local_map()
    assert local is not None
    assert local.drift == (0.05, 0.003)
    own.begin_submap(7, START, (0.05, 0.001), PRIOR)  # surer than before: it has come back to walls that it saw early
    node = own.graph.current
    assert node is not None
    assert np.diag(node.covariance) == pytest.approx((0.08, 0.07, 0.012), abs=2e-6)


@pytest.mark.parametrize(("steps", "path_m"), [([(1.0, 0.0), (1.0, 0.0)], 2.0), ([(0.3, 0.4), (0.0, -0.4)], 0.9)])
def test_a_submap_ends_after_its_way(steps: list[tuple[float, float]], path_m: float) -> None:
    for longer_m, is_over in ((-0.01, True), (0.01, False)):
        own = begun(path_m=path_m + longer_m)
        at = START
        scan(own, at)
        for dx_m, dy_m in steps:
            assert not own.is_over()
            at = Pose2D(at.x_m + dx_m, at.y_m + dy_m, at.yaw_rad)
            scan(own, at)
        assert own.is_over() == is_over
        own.begin_submap(6, at, NO_DRIFT, PRIOR)
        assert not own.is_over(), "the next one begins with no way"


def test_turns_count_as_way_too_whichever_way_round() -> None:
    for turn_rad in (1.0, -1.0):
        for path_m, is_over in ((0.59, True), (0.61, False)):
            own = begun(path_m=path_m)
            for yaw_rad in (3.0, 3.0 + turn_rad, 3.0):
                scan(own, Pose2D(START.x_m, START.y_m, math.remainder(yaw_rad, math.tau)))
            assert own.is_over() == is_over


def test_the_way_from_before_the_robot_was_lost_does_not_count() -> None:
    own = begun(path_m=1.0)
    scan(own, START)
    scan(own, Pose2D(START.x_m + 0.9, START.y_m, START.yaw_rad))
    own.begin_trajectory(1)
    own.begin_submap(6, START, NO_DRIFT, PRIOR)
    scan(own, Pose2D(6.0, 5.0, 0.0))
    assert not own.is_over(), "it was carried there"
    scan(own, Pose2D(6.9, 5.0, 0.0))
    assert not own.is_over()
    scan(own, Pose2D(6.9, 4.8, 0.0))
    assert own.is_over()


def test_a_robot_that_was_lost_goes_by_nothing_that_it_saw_before() -> None:
    own = begun()
    scan(own, START)
    assert own.grid.known_count > 1000
    own.begin_trajectory(1)
    assert own.trajectory == 1
    assert own.grid.known_count == 0
    assert own.number is None
    assert own.is_over()
    assert own.local_map() is None
    assert own.pop_patch() is None
    own.begin_submap(6, START, NO_DRIFT, PRIOR)
    local = own.local_map()
    assert local is not None
    assert (local.oldest, local.trajectory) == (6, 1)
    assert own.graph.own[5].trajectory != own.graph.own[6].trajectory


def test_a_patch_is_on_the_lattice_of_the_teams_grid_and_may_leave_it() -> None:
    own = begun(margin_m=1.0)
    local = Pose2D(-0.35, 2.0, 0.0)
    own.integrate(local, np.array([0.0]), np.array([1.0]), RANGE_M, 7, NOBODY, NO_DRIFT)
    patch = own.pop_patch()
    assert patch is not None
    assert patch.submap == 5
    cells = patch.cells
    assert (cells.row, cells.column) == (20, -4)
    assert cells.cells.shape == (1, 11)
    assert cells.cells[0, -1] == OCCUPIED
    assert set(cells.cells[0, :-1].tolist()) == {FREE}
    assert cells.stamp_ms == 7
    assert own.pop_patch() is None, "it is told once"


def test_what_a_robot_saw_in_the_submap_before_is_told_of_the_new_one_once_it_sees_it_again() -> None:
    own = begun()
    scan(own, START)
    first = own.pop_patch()
    own.begin_submap(6, START, NO_DRIFT, PRIOR)
    assert own.pop_patch() is None
    scan(own, START)
    second = own.pop_patch()
    assert first is not None
    assert second is not None
    assert second.submap == 6
    assert np.array_equal(first.cells.cells, second.cells.cells)


def test_surfaces_say_where_in_their_cells_the_walls_are_and_from_where_they_were_seen() -> None:
    own = begun()
    own.integrate(
        Pose2D(2.03, 2.07, 0.0), np.array([0.0, -math.pi / 2]), np.array([1.0, 1.02]), 6.0, 7, NOBODY, NO_DRIFT
    )
    surfaces = own.surfaces()
    assert surfaces.dtype == SURFACE
    assert len(surfaces) == 2
    for surface, (row, column, right, up, view) in zip(
        surfaces, [(10, 20, -0.2, 0.0, 192), (20, 30, -0.2, 0.2, 0)], strict=True
    ):
        assert (surface["row"], surface["column"], surface["view"]) == (row, column, view)
        assert surface["right"] / PARTS == pytest.approx(right, abs=0.6 / PARTS)
        assert surface["up"] / PARTS == pytest.approx(up, abs=0.6 / PARTS)


@settings(deadline=None, max_examples=30)
@given(bearing_rad=st.floats(-3.14, 3.14), range_m=st.floats(0.5, 2.0))
def test_what_is_told_of_a_wall_is_where_the_beam_ended(bearing_rad: float, range_m: float) -> None:
    own = begun()
    own.integrate(Pose2D(4.0, 4.0, 0.0), np.array([bearing_rad]), np.array([range_m]), 6.0, 7, NOBODY, NO_DRIFT)
    (surface,) = own.surfaces()
    x = surface["column"] + 0.5 + surface["right"] / PARTS
    y = surface["row"] + 0.5 + surface["up"] / PARTS
    assert x == pytest.approx(40.0 + 10.0 * range_m * math.cos(bearing_rad), abs=0.01)
    assert y == pytest.approx(40.0 + 10.0 * range_m * math.sin(bearing_rad), abs=0.01)
    view_rad = surface["view"] * math.tau / 256
    assert math.remainder(view_rad - bearing_rad, math.tau) == pytest.approx(0.0, abs=0.6 * math.tau / 256)


def test_only_walls_of_the_current_submap_are_told() -> None:
    own = begun()
    scan(own, ROOM_PLACES[0])
    assert len(own.surfaces()) > 40
    own.begin_submap(6, START, NO_DRIFT, PRIOR)
    assert len(own.surfaces()) == 0


def test_mates_and_drift_are_handed_on_to_the_map() -> None:
    own = begun()
    own.integrate(START, np.array([0.0]), np.array([1.0]), 6.0, 7, np.array([(1.95, 3.4, 0.2)]), (0.04, 0.01))
    assert len(own.surfaces()) == 0, "the beam ended at a mate"
    own.integrate(START, np.array([1.0]), np.array([1.0]), 6.0, 8, NOBODY, (0.04, 0.01))
    (row,), (column,) = np.nonzero(own.grid.surfaces.hits)
    assert own.grid.surfaces.drift[row, column] == pytest.approx((0.04, 0.01))


def ghost_on(own: OwnSubmaps) -> bool:
    """Whether floor that the robot sees, and the team takes for a wall, is told again."""
    scan(own, START)
    own.pop_patch()
    team = OccupancyGrid(GEOMETRY)
    team.merge_patch(31, 16, np.array([[OCCUPIED]], np.int8), 3)
    own.contradict(team)
    patch = own.pop_patch()
    if patch is None:
        return False
    assert (patch.cells.row, patch.cells.column) == (31, 16)
    assert patch.cells.cells.tolist() == [[FREE]]
    return True


@pytest.mark.parametrize(
    ("T_arena_local", "is_told"),
    [
        (IDENTITY, True),
        (Pose2D(0.03, -0.03, 0.0), True),
        (Pose2D(-0.06, 0.0, 0.0), False),
        (Pose2D(0.0, 0.06, 0.0), False),
        (Pose2D(0.05, 0.0, 0.0), False),  # half a cell
        (Pose2D(0.0, 0.0, -0.002), True),
        (Pose2D(0.0, 0.0, -0.003), False),  # 20 m on that is more than half a cell
        (Pose2D(0.03, 0.0, 0.002), False),
    ],
)
def test_floor_that_the_team_takes_for_a_wall_is_told_again_where_cells_are_the_teams(
    T_arena_local: Pose2D, is_told: bool
) -> None:
    own = begun()
    own.T_arena_local = T_arena_local
    assert ghost_on(own) == is_told
