"""How far from the belief a scan is looked for on a submap, and how well it has to lie there."""

import numpy as np
import pytest

from robrain.algorithms.slam.loop_closure import Contradiction, Lying, lay_on
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


def test_a_place_that_is_looked_for_and_not_found_tells_nothing():
    submap = ROOM.submap(*ROOM_PLACES)
    assert lay_on(submap, GEOMETRY, Pose2D(7.0, 5.0, 0.0), ROOM.points(Pose2D(1.0, 1.0, 1.5)), 0.3, 0.05) is None


def test_a_scan_that_lies_elsewhere_contradicts_a_submap_that_knows_the_place():
    submap = ROOM.submap(*ROOM_PLACES)
    contradiction = lay_on(submap, GEOMETRY, TRUE, ROOM.points(ELSEWHERE), *SURE)
    assert isinstance(contradiction, Contradiction)
    assert contradiction.agrees < 0.75


def test_along_a_corridor_nothing_is_told():
    submap, true = CORRIDOR.submap(*CORRIDOR_PLACES), Pose2D(6.0, 4.0, 0.1)
    lying = lay_on(submap, GEOMETRY, beside(true, 0.1, 0.05, 0.02), CORRIDOR.points(true), *SURE)
    assert isinstance(lying, Lying)
    assert off(lying.sensor, beside(true, 0.1, 0.0, 0.0)) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    values = np.linalg.eigvalsh(lying.information[:2, :2])
    assert lying.information[0, 0] < 0.01 * lying.information[1, 1]
    assert values[0] < 0.01 * values[1]


SUBMAP = ROOM.submap(*ROOM_PLACES)


def laid(x_m: float, turn_rad: float, sigma_m: float, sigma_rad: float) -> Lying | Contradiction | None:
    """A scan of TRUE, laid on the submap by a robot that believes to be so far beside it."""
    believed = Pose2D(TRUE.x_m + x_m, TRUE.y_m, TRUE.yaw_rad + turn_rad)
    return lay_on(SUBMAP, GEOMETRY, believed, ROOM.points(TRUE), sigma_m, sigma_rad)


@pytest.mark.parametrize(
    ("x_m", "turn_rad", "sigma_m", "sigma_rad", "is_found"),
    [
        (1.0, 0.0, 0.35, 0.01, True),
        (1.0, 0.0, 0.21, 0.01, False),  # more than three standard deviations
        (0.0, 0.45, 0.01, 0.16, True),
        (0.0, 0.45, 0.01, 0.1, False),
        (2.45, 0.0, 9.0, 0.01, True),
        (3.2, 0.0, 9.0, 0.01, False),  # so far nobody looks
        (0.0, 0.5, 0.01, 0.9, True),
        (0.0, 0.75, 0.01, 0.9, False),
        (0.5, 0.0, 0.21, 0.01, True),
        (0.5, 0.0, 0.19, 0.01, False),  # one that is so sure does not look for its place
        (0.0, 0.17, 0.01, 0.061, True),
    ],
)
def test_a_scan_is_looked_for_as_far_as_the_belief_may_be_wrong(
    x_m: float, turn_rad: float, sigma_m: float, sigma_rad: float, is_found: bool
) -> None:
    lying = laid(x_m, turn_rad, sigma_m, sigma_rad)
    assert isinstance(lying, Lying) == is_found
    if isinstance(lying, Lying):
        assert lying.sensor.distance_m(TRUE) < 0.02
