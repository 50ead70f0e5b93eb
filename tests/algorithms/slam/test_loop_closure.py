import numpy as np
import pytest

from robrain.algorithms.slam.loop_closure import Contradiction, Lying, geometry_of, lay_on
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from tests.algorithms.mapping.lidar_floor import CORRIDOR, CORRIDOR_PLACES, GEOMETRY, ROOM, ROOM_PLACES
from tests.algorithms.slam.submap_walks import off

SURE = 0.05, 0.02
ELSEWHERE = Pose2D(6.8, 1.0, 2.2)
TRUE = Pose2D(2.3, 4.1, 0.8)


def beside(pose, x_m, y_m, turn_rad):
    return Pose2D(pose.x_m + x_m, pose.y_m + y_m, pose.yaw_rad + turn_rad)


@pytest.mark.parametrize("T_arena_local", [IDENTITY, Pose2D(3.0, -2.0, 0.7), Pose2D(-1.0, 0.5, -2.2)])
@pytest.mark.parametrize("true", [TRUE, Pose2D(6.9, 5.1, -2.0), Pose2D(4.5, 1.0, 3.0)])
def test_a_scan_comes_to_lie_where_it_was_made_in_the_submaps_frame(T_arena_local, true):
    submap = ROOM.submap(*ROOM_PLACES, T_arena_local=T_arena_local)
    believed = T_arena_local.compose(beside(true, 0.1, -0.08, 0.04))
    lying = lay_on(submap, GEOMETRY, believed, ROOM.points(true), *SURE)
    assert isinstance(lying, Lying)
    assert off(lying.sensor, true) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert lying.information == pytest.approx(lying.information.T)
    sigmas = np.sqrt(np.diag(np.linalg.inv(lying.information)))
    assert np.all(sigmas < (0.05, 0.05, 0.02))
    assert np.all(sigmas > (0.005, 0.005, 0.001)), "it is laid on cells, not on the walls themselves"


def test_where_the_belief_is_not_sure_the_place_is_looked_for():
    submap = ROOM.submap(*ROOM_PLACES)
    believed = beside(TRUE, 0.9, -0.7, 0.3)
    lying = lay_on(submap, GEOMETRY, believed, ROOM.points(TRUE), 0.6, 0.2)
    assert isinstance(lying, Lying)
    assert off(lying.sensor, TRUE) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert not isinstance(lay_on(submap, GEOMETRY, believed, ROOM.points(TRUE), *SURE), Lying)


def test_a_place_that_is_looked_for_and_not_found_tells_nothing():
    submap = ROOM.submap(*ROOM_PLACES)
    assert lay_on(submap, GEOMETRY, Pose2D(7.0, 5.0, 0.0), ROOM.points(Pose2D(1.0, 1.0, 1.5)), 0.3, 0.05) is None


def test_a_scan_that_lies_elsewhere_contradicts_a_submap_that_knows_the_place():
    submap = ROOM.submap(*ROOM_PLACES)
    contradiction = lay_on(submap, GEOMETRY, TRUE, ROOM.points(ELSEWHERE), *SURE)
    assert isinstance(contradiction, Contradiction)
    assert contradiction.agrees < 0.75


@pytest.mark.slow
def test_a_submap_that_does_not_know_the_place_tells_nothing():
    submap = ROOM.submap(Pose2D(7.0, 5.0, 0.0))
    assert lay_on(submap, GEOMETRY, Pose2D(60.0, 40.0, 0.0), ROOM.points(TRUE), *SURE) is None
    assert lay_on(submap, GEOMETRY, TRUE, np.empty((0, 2)), *SURE) is None
    assert lay_on(submap, GEOMETRY, TRUE, ROOM.points(TRUE)[::30], *SURE) is None


def test_along_a_corridor_nothing_is_told():
    submap, true = CORRIDOR.submap(*CORRIDOR_PLACES), Pose2D(6.0, 4.0, 0.1)
    lying = lay_on(submap, GEOMETRY, beside(true, 0.1, 0.05, 0.02), CORRIDOR.points(true), *SURE)
    assert isinstance(lying, Lying)
    assert off(lying.sensor, beside(true, 0.1, 0.0, 0.0)) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    values = np.linalg.eigvalsh(lying.information[:2, :2])
    assert lying.information[0, 0] < 0.01 * lying.information[1, 1]
    assert values[0] < 0.01 * values[1]


def test_the_frame_of_a_submaps_cells_is_on_the_teams_lattice():
    submap = ROOM.submap(*ROOM_PLACES)
    geometry = geometry_of(submap, GEOMETRY)
    assert geometry.shape == submap.evidence.shape
    assert geometry.origin_x_m == pytest.approx(0.1 * submap.column)
    row, column = geometry.cell_of(0.25, 3.05)
    assert submap.evidence[row, column] > 0  # the wall on the left
    row, column = geometry.cell_of(1.55, 3.05)
    assert submap.evidence[row, column] < 0


@pytest.mark.parametrize(("count", "is_enough"), [(19, False), (20, True)])
def test_a_scan_of_twenty_beams_can_be_laid(count, is_enough):
    submap, points = ROOM.submap(*ROOM_PLACES), ROOM.points(TRUE)
    few = points[np.linspace(0, len(points) - 1, count).astype(int)]
    assert (lay_on(submap, GEOMETRY, TRUE, few, *SURE) is not None) == is_enough
