import math

import numpy as np
import pytest

from robrain.algorithms.localization.localiser import Localiser, LocaliserSpec
from robrain.algorithms.localization.odometry import moved_along
from robrain.protocol.model.geometry import Pose2D, Twist2D
from tests.algorithms.mapping.lidar_floor import CORRIDOR, CORRIDOR_PLACES, ROOM, ROOM_PLACES, local_map


def at(localiser, pose):
    return (
        localiser.pose.x_m - pose.x_m,
        localiser.pose.y_m - pose.y_m,
        math.remainder(localiser.pose.yaw_rad - pose.yaw_rad, math.tau),
    )


def room_map(**how):
    return local_map(ROOM.mapped(*ROOM_PLACES), **how)


def located(believed, sigma_m=0.1, sigma_rad=0.03, **spec):
    return Localiser(believed, sigma_m, sigma_rad, LocaliserSpec(**spec))


@pytest.mark.parametrize("T_arena_local", [Pose2D(0.0, 0.0, 0.0), Pose2D(3.0, -2.0, 0.7), Pose2D(-1.0, 0.5, -2.2)])
@pytest.mark.parametrize("off", [(0.06, -0.04, 0.03), (-0.05, 0.0, -0.02)])
def test_a_scan_puts_a_robot_where_it_lies_on_its_own_map(T_arena_local, off):
    true = Pose2D(2.3, 4.1, 0.8)
    localiser = located(T_arena_local.compose(Pose2D(true.x_m + off[0], true.y_m + off[1], true.yaw_rad + off[2])))
    fit = localiser.see(ROOM.points(true), room_map(T_arena_local=T_arena_local))
    assert fit.fit > 0.9
    assert localiser.fits
    assert at(localiser, T_arena_local.compose(true)) == pytest.approx((0.0, 0.0, 0.0), abs=0.015)
    assert localiser.filter.sigma_m == pytest.approx(0.03, abs=0.01)


@pytest.mark.parametrize("yaw_rad", [0.0, 1.1])
def test_along_a_corridor_a_scan_moves_nothing_and_the_robot_is_no_surer(yaw_rad):
    T_arena_local = Pose2D(1.0, 2.0, yaw_rad)
    true = T_arena_local.compose(Pose2D(6.0, 4.0, 0.2))
    along, across = (math.cos(yaw_rad), math.sin(yaw_rad)), (-math.sin(yaw_rad), math.cos(yaw_rad))
    believed = Pose2D(true.x_m + 0.05 * along[0], true.y_m + 0.05 * along[1], true.yaw_rad)
    believed = Pose2D(believed.x_m + 0.05 * across[0], believed.y_m + 0.05 * across[1], believed.yaw_rad)
    localiser = located(believed, sigma_m=0.1)
    map = local_map(CORRIDOR.mapped(*CORRIDOR_PLACES), T_arena_local)
    localiser.see(CORRIDOR.points(Pose2D(6.0, 4.0, 0.2)), map)
    dx_m, dy_m, turn_rad = at(localiser, true)
    assert dx_m * along[0] + dy_m * along[1] == pytest.approx(0.05, abs=0.01)
    assert dx_m * across[0] + dy_m * across[1] == pytest.approx(0.0, abs=0.01)
    assert turn_rad == pytest.approx(0.0, abs=0.01)
    covariance = localiser.covariance[:2, :2]
    assert np.array(along) @ covariance @ along == pytest.approx(0.01, rel=0.1)
    assert np.array(across) @ covariance @ across < 0.0015


def test_a_scan_counts_where_it_was_made_though_the_robot_has_gone_on():
    then, now = Pose2D(2.3, 4.1, 0.8), Pose2D(2.6, 4.3, 1.3)
    localiser = located(Pose2D(now.x_m + 0.05, now.y_m - 0.03, now.yaw_rad + 0.02))
    localiser.see(ROOM.points(then), room_map(), now.inverse().compose(then))
    assert at(localiser, now) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_a_scan_that_lies_elsewhere_does_not_fit_and_eight_of_them_mean_that_the_robot_is_lost():
    localiser = located(Pose2D(2.3, 4.1, 0.8))
    map, elsewhere = room_map(), ROOM.points(Pose2D(6.8, 1.0, 2.2))
    localiser.see(ROOM.points(localiser.pose), map)
    assert localiser.fits
    for count in range(8):
        assert localiser.lost == ""
        localiser.see(elsewhere, map)
        assert localiser.fits == (count == 7), f"scan {count}"  # a lost robot begins a new map, which fits
        localiser.move(Twist2D(0.05, 0.0, 0.0))
    assert "do not fit the map" in localiser.lost


def test_how_unsure_the_place_of_the_map_is_counts_in_the_covariance_but_not_in_what_scans_correct():
    true = Pose2D(5.0, 1.0, 0.0)
    anchor, variances = Pose2D(1.0, 1.0, 0.0), (0.04, 0.09, 0.01)
    localiser, sure = located(true), located(true)
    sure.see(ROOM.points(true), room_map())
    localiser.see(ROOM.points(true), room_map(anchor=anchor, variances=variances))
    assert np.array_equal(localiser.filter.covariance, sure.filter.covariance)
    by_map = localiser.covariance - sure.covariance
    # Four metres from the anchor its yaw moves the robot by 0.4 m to the side.
    assert np.diag(by_map) == pytest.approx((0.04, 0.09 + 0.16, 0.01), rel=1e-3)
    assert localiser.sigma_m > 0.4 > sure.sigma_m


def test_an_error_of_place_that_comes_from_yaw_grows_with_the_way():
    """Place and yaw of the anchor have one cause: a way of 2 m that was driven in a wrong direction."""
    true = Pose2D(5.0, 1.0, 0.0)
    localiser, sure = located(true), located(true)
    sure.see(ROOM.points(true), room_map())
    so_far = room_map(anchor=Pose2D(3.0, 1.0, 0.0), variances=(0.0, 0.04, 0.01))
    localiser.see(ROOM.points(true), so_far._replace(with_yaw=(0.0, 0.02)))
    assert (localiser.covariance - sure.covariance)[1, 1] == pytest.approx(0.16, rel=1e-3)


def test_what_the_submap_had_of_drift_when_it_began_is_in_its_own_variances():
    """Else it would count twice: in where the submap lies, and in what its walls were drawn from."""
    true = Pose2D(2.3, 4.1, 0.8)
    drawn = ROOM.mapped(*ROOM_PLACES, drift=(0.04, 0.0025))
    localiser, sure = located(true), located(true)
    sure.see(ROOM.points(true), room_map())
    localiser.see(ROOM.points(true), local_map(drawn, drift=(0.04, 0.0025)))
    assert localiser.covariance == pytest.approx(sure.covariance, abs=1e-6)


def test_a_lost_robot_goes_by_the_walls_that_it_has_seen_since():
    true = Pose2D(2.3, 4.1, 0.8)
    localiser = located(Pose2D(true.x_m + 0.03, true.y_m - 0.02, true.yaw_rad))
    localiser.lose("it was carried")
    localiser.move(Twist2D(0.05, 0.0, 0.0))
    there = moved_along(true, Twist2D(0.05, 0.0, 0.0))
    localiser.see(ROOM.points(there), local_map(ROOM.mapped(*ROOM_PLACES), trajectory=1))
    assert at(localiser, there) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert localiser.lost == "it was carried"
