import math

import numpy as np
import pytest

from robrain.algorithms.localization.localiser import Localiser, LocaliserSpec
from robrain.algorithms.localization.odometry import moved_along
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from tests.algorithms.mapping.lidar_floor import CORRIDOR, CORRIDOR_PLACES, GEOMETRY, ROOM, ROOM_PLACES, local_map
from tests.bench.localisation import SILENT_S, follow
from tests.bench.localisation_world import drive

MOTES = [Point2D(float(x), float(y)) for x in (2, 9, 17) for y in (3, 10, 18)]
LOSS = PathLoss()


class Walk:
    """A robot that drives in rounds; its odometry is exact, its motes have 3 dB of noise."""

    def __init__(self) -> None:
        self.true = Pose2D(10.0, 6.0, 0.0)
        self.localiser = Localiser(self.true, 0.05, 0.02, LocaliserSpec(maps=False))
        self._rng = np.random.default_rng(4)
        self._step = 0

    def go(self, seconds: float, *, deaf: bool = False) -> None:
        for _ in range(round(10 * seconds)):
            self._step += 1
            by = Twist2D(0.05, 0.0, 0.012)
            self.true = moved_along(self.true, by)
            self.localiser.move(by)
            if self._step % 4 == 0 and not deaf:
                mote = MOTES[self._step // 4 % len(MOTES)]
                rssi_dbm = LOSS.mean_dbm(self.true.distance_m(mote)) + 3.0 * self._rng.standard_normal()
                self.localiser.hear(RssiSample(f"{mote}", mote, rssi_dbm))
                if self.localiser.arena_fix is not None:
                    self.localiser.place(*self.localiser.arena_fix)

    @property
    def error_m(self) -> float:
        return self.true.distance_m(self.localiser.pose)


def test_motes_keep_a_robot_found_and_their_covariance_tells_how_well():
    walk = Walk()
    walk.go(120.0)
    assert walk.localiser.lost == ""
    assert walk.error_m < 3 * walk.localiser.sigma_m < 3.0


@pytest.mark.parametrize("parts", [1, 4])
def test_an_estimate_is_all_the_properties_of_that_name(parts: int) -> None:
    localiser = Localiser(Pose2D(10.0, 6.0, 1.0), 0.5, 0.02 if parts == 1 else 1.0, LocaliserSpec())
    for _ in range(10):
        localiser.move(Twist2D(0.05, 0.01, 0.012))
        localiser.hear(RssiSample("m", Point2D(14.0, 9.0), -60.0))
    assert (len(localiser.filter) > 1) == (parts > 1)
    told = localiser.estimate()
    assert (told.pose, told.covariances, told.drift) == (localiser.pose, localiser.covariances, localiser.drift)
    assert told.local_sigma_m == localiser.local_sigma_m


def test_a_robot_that_is_carried_off_says_so_and_finds_itself_again():
    walk = Walk()
    walk.go(40.0)
    walk.true = Pose2D(walk.true.x_m + 5.0, walk.true.y_m + 4.0, walk.true.yaw_rad + 2.0)
    said_after_s = 0
    while not walk.localiser.lost:
        walk.go(1.0)
        said_after_s += 1
        assert said_after_s < 60
    assert walk.localiser.sigma_m > 3.0
    while walk.localiser.lost:
        walk.go(1.0)
        said_after_s += 1
        assert said_after_s < 180
    walk.go(20.0)
    assert walk.localiser.lost == ""
    assert walk.error_m < 1.5
    assert math.remainder(walk.true.yaw_rad - walk.localiser.pose.yaw_rad, math.tau) == pytest.approx(0.0, abs=0.4)


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


def test_an_offset_within_the_slack_is_taken_for_none():
    true = Pose2D(2.3, 4.1, 0.0)
    for slack_cells, left_m in ((0.0, 0.0), (0.2, 0.02), (0.9, 0.04)):
        localiser = located(Pose2D(2.34, 4.1, 0.0), slack_cells=slack_cells)
        localiser.see(ROOM.points(true), room_map())
        assert localiser.pose.x_m - true.x_m == pytest.approx(left_m, abs=0.008)


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


def test_a_robot_whose_wheels_have_slipped_more_than_was_told_is_back_within_a_few_scans():
    """What the first scans say cannot be; but they go on saying so."""
    true = Pose2D(2.3, 4.1, 0.8)
    localiser = located(true, sigma_m=0.02, sigma_rad=0.01)
    map = room_map()
    localiser.move(Twist2D(0.05, 0.0, 0.0))
    true = moved_along(true, Twist2D(0.13, -0.1, 0.12))
    localiser.see(ROOM.points(true), map)
    assert not localiser.fits
    for _ in range(3):
        localiser.see(ROOM.points(true), map)
    assert localiser.fits
    assert localiser.lost == ""
    assert at(localiser, true) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2001, 2018, 2042])
def test_a_robot_whose_map_has_turned_with_it_says_how_far_off_it_may_be(seed):
    """Walls drawn while its yaw was wrong by 5°: 10 m from where that began, the robot is nearly 1 m off."""
    track = follow(drive(seed), motes=False, scans=True)
    assert track.rmse_m > 0.2
    assert track.silent_s < SILENT_S


def test_what_the_submap_had_of_drift_when_it_began_is_in_its_own_variances():
    """Else it would count twice: in where the submap lies, and in what its walls were drawn from."""
    true = Pose2D(2.3, 4.1, 0.8)
    drawn = ROOM.mapped(*ROOM_PLACES, drift=(0.04, 0.0025))
    localiser, sure = located(true), located(true)
    sure.see(ROOM.points(true), room_map())
    localiser.see(ROOM.points(true), local_map(drawn, drift=(0.04, 0.0025)))
    assert localiser.covariance == pytest.approx(sure.covariance, abs=1e-6)


def test_going_back_to_walls_that_were_drawn_early_makes_a_robot_surer_again():
    true = Pose2D(2.3, 4.1, 0.8)
    localiser = located(true)
    localiser.see(ROOM.points(true), local_map(ROOM.mapped(*ROOM_PLACES, drift=(0.04, 0.0025))))
    localiser.move(Twist2D(0.1, 0.0, 0.0))
    there = moved_along(true, Twist2D(0.1, 0.0, 0.0))
    localiser.see(ROOM.points(there), room_map())
    assert localiser.drift[0] < 0.001
    assert localiser.sigma_m < 0.05


def test_a_new_trajectory_begins_without_drift():
    true = Pose2D(2.3, 4.1, 0.8)
    localiser = located(true)
    localiser.see(ROOM.points(true), local_map(ROOM.mapped(*ROOM_PLACES, drift=(0.04, 0.0025))))
    empty = OccupancyGrid(GEOMETRY, surfaces=True)
    localiser.see(ROOM.points(true), local_map(empty, drift=(0.04, 0.0025), trajectory=1))
    assert localiser.drift[0] < 0.001


def test_walls_that_are_moved_take_the_robot_along():
    start, T_new_old = Pose2D(5.0, 2.0, 0.4), Pose2D(0.3, -0.2, 0.5)
    localiser = located(start, sigma_m=0.05, sigma_rad=0.02)
    localiser.filter.add((0.09, 0.0, 0.0))
    before = localiser.covariance
    localiser.shift(T_new_old)
    assert at(localiser, T_new_old.compose(start)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    turn = np.eye(3)
    turn[:2, :2] = [[math.cos(0.5), -math.sin(0.5)], [math.sin(0.5), math.cos(0.5)]]
    assert localiser.covariance == pytest.approx(turn @ before @ turn.T, abs=1e-9)


def test_an_empty_map_corrects_nothing_and_is_no_misfit():
    localiser = located(Pose2D(2.3, 4.1, 0.8))
    for _ in range(20):
        localiser.see(ROOM.points(Pose2D(2.3, 4.1, 0.8)), local_map(OccupancyGrid(GEOMETRY, surfaces=True)))
    assert at(localiser, Pose2D(2.3, 4.1, 0.8)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert localiser.fits
    assert localiser.lost == ""


def test_a_lost_robot_goes_by_the_walls_that_it_has_seen_since():
    true = Pose2D(2.3, 4.1, 0.8)
    localiser = located(Pose2D(true.x_m + 0.03, true.y_m - 0.02, true.yaw_rad))
    localiser.lose("it was carried")
    localiser.move(Twist2D(0.05, 0.0, 0.0))
    there = moved_along(true, Twist2D(0.05, 0.0, 0.0))
    localiser.see(ROOM.points(there), local_map(ROOM.mapped(*ROOM_PLACES), trajectory=1))
    assert at(localiser, there) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert localiser.lost == "it was carried"


def test_a_robot_whose_frame_becomes_the_arena_frame_is_not_lost_any_more_and_its_estimate_goes_on():
    localiser = located(Pose2D(6.0, 1.0, 0.4))
    localiser.lose("it was carried")
    before = localiser.covariance
    localiser.join()
    assert localiser.lost == ""
    assert localiser.beginnings == 1
    assert np.array_equal(localiser.covariance, before)


def test_a_robot_that_leaves_the_arena_frame_is_lost_and_its_estimate_goes_on():
    localiser = located(Pose2D(6.0, 1.0, 0.4))
    before = localiser.covariance
    localiser.part("mates contradict it")
    assert localiser.lost == "mates contradict it"
    assert localiser.beginnings == 0
    assert np.array_equal(localiser.covariance, before)


def test_scans_that_show_no_walls_make_a_robot_no_less_sure_the_more_of_them_there_are():
    sigmas_m = []
    for steps_a_scan in (1, 50):
        localiser = located(Pose2D(2.0, 4.0, 0.0), sigma_m=0.02, sigma_rad=0.01)
        for step in range(100):
            localiser.move(Twist2D(0.05, 0.0, 0.0))
            if step % steps_a_scan == 0:
                localiser.see(np.empty((0, 2)), local_map(OccupancyGrid(GEOMETRY, surfaces=True)))
        sigmas_m.append(localiser.sigma_m)
    assert sigmas_m[0] < 1.5 * sigmas_m[1]
