"""What scans and motes do to a robot's place: gates, floors of the covariance, frames, and when it is lost."""

import math

import numpy as np
import pytest

from robrain.algorithms.localization import localiser as module
from robrain.algorithms.localization.localiser import (
    REFUSED_SIGMA_M,
    DivergenceMonitor,
    DivergenceSpec,
    Localiser,
    LocaliserSpec,
)
from robrain.algorithms.localization.odometry import moved_along
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D, Twist2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from tests.algorithms.mapping.lidar_floor import CORRIDOR, CORRIDOR_PLACES, ROOM, ROOM_PLACES, local_map


def at(localiser, pose):
    return (
        localiser.pose.x_m - pose.x_m,
        localiser.pose.y_m - pose.y_m,
        math.remainder(localiser.pose.yaw_rad - pose.yaw_rad, math.tau),
    )


def room_map(**how):
    return local_map(ROOM.mapped(*ROOM_PLACES), **how)


TRUE = Pose2D(2.3, 4.1, 0.8)


def located(believed=TRUE, sigma_m=0.1, sigma_rad=0.03, **spec):
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


def test_a_lost_robot_goes_by_the_walls_that_it_has_seen_since():
    true = Pose2D(2.3, 4.1, 0.8)
    localiser = located(Pose2D(true.x_m + 0.03, true.y_m - 0.02, true.yaw_rad))
    localiser.lose("it was carried")
    localiser.move(Twist2D(0.05, 0.0, 0.0))
    there = moved_along(true, Twist2D(0.05, 0.0, 0.0))
    localiser.see(ROOM.points(there), local_map(ROOM.mapped(*ROOM_PLACES), trajectory=1))
    assert at(localiser, there) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert localiser.lost == "it was carried"


ELSEWHERE = Pose2D(6.8, 1.0, 2.2)
MOTES = [Point2D(float(x), float(y)) for x in (2, 9, 17) for y in (3, 10, 18)]
LOSS = PathLoss()
STEP = Twist2D(0.15, 0.0, 0.05)


HERE = Pose2D(10.0, 6.0, 0.0)


class Listener:
    """A robot that drives a curve and receives a mote at its true pose with each step."""

    def __init__(self, true=HERE, believed=HERE, **spec):
        self.true = true
        self.localiser = Localiser(believed, 0.1, 0.05, LocaliserSpec(**spec))
        self.received = 0

    def step(self, motes=9):
        self.true = moved_along(self.true, STEP)
        self.localiser.move(STEP)
        mote = MOTES[self.received % motes]
        self.localiser.receive(RssiSample(f"m{self.received % motes}", mote, LOSS.mean_dbm(self.true.distance_m(mote))))
        self.received += 1


@pytest.mark.parametrize("before", [13, 20])
def test_a_robot_that_leaves_the_arena_frame_looks_for_itself_by_what_it_hears_from_then_on(before: int) -> None:
    """Every eighth signal, once there are enough; those from before may be what has led it astray."""
    fresh, robot = Listener(), Listener()
    fresh.localiser.part("teammates contradict it")
    for _ in range(before):
        robot.step()
    robot.localiser.part("teammates contradict it")
    assert robot.localiser.lost == "teammates contradict it"
    robot.received = 0
    for each in (fresh, robot):
        while each.localiser.arena_fix is None:
            each.step()
            assert each.received < 80
    assert robot.received == fresh.received
    assert robot.received % 8 == 0
    pose, _ = robot.localiser.arena_fix or (IDENTITY, None)
    assert pose.distance_m(robot.true) < 1.0


def test_where_a_robot_may_be_is_asked_of_what_it_has_heard_since_it_left_its_frame() -> None:
    robot = Listener()
    assert robot.localiser.may_be_at(ELSEWHERE), "it has received nothing"
    allowed = []
    for _ in range(14):
        robot.step()
        allowed.append(robot.localiser.may_be_at(robot.true))
    assert allowed == [False] * 11 + [True] * 3
    assert not robot.localiser.may_be_at(Pose2D(2.0, 16.0, 0.0))
    robot.localiser.part("teammates contradict it")
    assert not robot.localiser.may_be_at(robot.true)
    for _ in range(12):
        robot.step()
    assert robot.localiser.may_be_at(robot.true)


GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 80, 60)
START = Pose2D(4.0, 1.05, 0.0)


def others_map() -> OccupancyGrid:
    """Floor, and a wall 2 m ahead on the left."""
    classes = np.full(GEOMETRY.shape, FREE, np.int8)
    classes[30] = OCCUPIED
    classes[31:] = -1
    grid = OccupancyGrid(GEOMETRY)
    grid.merge_patch(0, 0, classes, 5)
    return grid


def beams(at_wall: int, on_floor: int, beyond: int = 0) -> np.ndarray:
    """End points of beams, sensor's frame: numbers at the wall, short of it, and where nothing is known."""
    ends_m = [2.0] * at_wall + [1.2] * on_floor + [0.0] * beyond
    points = np.array([(0.1 * n - 1.0, y_m) for n, y_m in enumerate(ends_m)])
    points[at_wall + on_floor :] = (-30.0, 0.0)
    return points


@pytest.mark.parametrize(
    ("at_wall", "on_floor", "beyond", "is_decided", "is_lost"),
    [
        (10, 0, 0, True, False),
        (6, 4, 0, True, False),  # six in ten are enough
        (5, 5, 0, True, True),
        (0, 10, 0, True, True),
        (5, 0, 5, True, False),  # the map knows half of it
        (0, 5, 5, True, True),
        (0, 4, 5, False, False),
    ],
)
def test_a_start_is_false_if_the_map_knows_the_place_and_most_of_what_is_seen_is_otherwise(
    at_wall: int, on_floor: int, beyond: int, is_decided: bool, is_lost: bool
) -> None:
    localiser, others = located(START), others_map()
    verdict = localiser.check_start(others.log_odds, others.geometry, beams(at_wall, on_floor, beyond))
    assert verdict is is_decided
    assert bool(localiser.lost) == is_lost
    assert localiser.beginnings == is_lost


DEAF_WATCH = DivergenceSpec(nis_max=1e9, refused_max=1.0)
"""A watch that reports nothing of what it receives."""


def test_signals_that_speak_for_another_place_say_that_the_robot_is_lost():
    robot = Listener(Pose2D(4.0, 14.0, 2.0), HERE, watch=DEAF_WATCH)
    while not robot.localiser.lost:
        robot.step()
        assert robot.received <= 24
    assert robot.received == 24
    assert "the last 24 signals of motes speak for another place" in robot.localiser.lost


def test_few_motes_cannot_say_that_the_robot_is_elsewhere():
    robot = Listener(Pose2D(4.0, 14.0, 2.0), HERE, watch=DEAF_WATCH)
    for _ in range(60):
        robot.step(motes=3)
    assert robot.localiser.lost == ""


def test_innovations_that_are_too_large_say_so_at_once():
    robot = Listener(Pose2D(17.0, 12.0, 0.0), HERE, watch=DivergenceSpec(window=4))
    while not robot.localiser.lost:
        robot.step()
        assert robot.received < 12
    assert "signals of motes" in robot.localiser.lost


def test_a_lost_robot_is_found_by_motes_as_soon_as_they_are_enough():
    robot = Listener(Pose2D(4.0, 12.0, 0.0), HERE)
    robot.localiser.lose("it was carried")
    while robot.localiser.arena_fix is None:
        robot.step()
        assert robot.received < 90
    assert robot.received % 8 == 0
    assert robot.localiser.lost == "it was carried"
    robot.localiser.place(*robot.localiser.arena_fix)
    assert robot.localiser.lost == ""
    assert robot.localiser.arena_fix is None
    assert robot.localiser.beginnings == 2
    assert robot.localiser.fits
    off = np.array(
        (
            robot.localiser.pose.x_m - robot.true.x_m,
            robot.localiser.pose.y_m - robot.true.y_m,
            math.remainder(robot.localiser.pose.yaw_rad - robot.true.yaw_rad, math.tau),
        )
    )
    assert off @ np.linalg.solve(robot.localiser.covariance, off) < 16.0


FOUND = Pose2D(3.0, 4.0, 0.5)


@pytest.mark.parametrize(
    ("variances", "is_found"),
    [
        ((2.2, 2.2, 0.24), True),
        ((2.3, 0.1, 0.1), False),
        ((0.1, 2.3, 0.1), False),
        ((0.1, 0.1, 0.26), False),
    ],
)
def test_an_answer_that_is_not_sure_is_none(monkeypatch, variances, is_found):
    monkeypatch.setattr(module, "find_robot", lambda *_: (FOUND, np.diag(variances)))
    robot = Listener()
    robot.localiser.lose("it was carried")
    for _ in range(24):
        assert robot.localiser.arena_fix is None
        robot.step()
    assert (robot.localiser.arena_fix is not None) == is_found
    assert robot.localiser.lost
    if is_found:
        robot.localiser.place(*robot.localiser.arena_fix)
        assert robot.localiser.pose == FOUND
        assert np.diag(robot.localiser.covariance) == pytest.approx(variances)


ROOM_MAP = ROOM.mapped(*ROOM_PLACES)
FORWARD = Twist2D(0.05, 0.0, 0.0)


def beside(pose, x_m, y_m=0.0, turn_rad=0.0):
    return Pose2D(pose.x_m + x_m, pose.y_m + y_m, pose.yaw_rad + turn_rad)


@pytest.mark.parametrize("bearing_rad", [0.0, 1.5, -2.2])
@pytest.mark.parametrize(("off_m", "is_believed"), [(0.235, True), (0.258, False)])
def test_a_scan_that_lies_farther_off_than_one_in_a_thousand_is_refused(bearing_rad, off_m, is_believed):
    """The gate of three directions is 16.27: four times 0.06 m, and what walls are off by."""
    believed = beside(TRUE, off_m * math.cos(bearing_rad), off_m * math.sin(bearing_rad))
    localiser = located(believed, sigma_m=0.06, sigma_rad=0.01, search_m=1.0)
    localiser.see(ROOM.points(TRUE), local_map(ROOM_MAP))
    assert localiser.fits == is_believed
    if is_believed:
        assert at(localiser, TRUE) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    else:
        assert at(localiser, believed) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
        assert localiser.filter.sigma_m == pytest.approx(math.hypot(0.06, REFUSED_SIGMA_M)), "but the robot doubts"


@pytest.mark.parametrize("misfits_max", [1, 2])
def test_a_scan_that_is_refused_counts_as_one_that_does_not_fit(misfits_max):
    localiser = located(beside(TRUE, 0.2), sigma_m=0.03, sigma_rad=0.01, watch=DivergenceSpec(misfits_max=misfits_max))
    localiser.move(Twist2D(0.03, 0.0, 0.0))
    localiser.move(Twist2D(-0.03, 0.0, 0.0))
    fit = localiser.see(ROOM.points(TRUE), local_map(ROOM_MAP))
    assert fit.fit > 0.9, "it would fit elsewhere"
    assert bool(localiser.lost) == (misfits_max == 1)
    localiser.see(ROOM.points(TRUE), local_map(ROOM_MAP))
    assert bool(localiser.lost) == (misfits_max == 1), "the next one is believed"


def test_after_a_match_nobody_is_surer_than_the_floor():
    localiser, precise = located(), located(floor_m=0.0, floor_rad=0.0)
    for each in (localiser, precise):
        each.see(ROOM.points(TRUE), local_map(ROOM_MAP))
    assert np.diag(localiser.filter.covariance) == pytest.approx((0.03**2, 0.03**2, 0.005**2))
    x, y, yaw = np.sqrt(np.diag(precise.filter.covariance)).tolist()
    assert 0.008 < min(x, y) <= max(x, y) < 0.016
    assert 0.002 < yaw < 0.005


@pytest.mark.parametrize("maps", [True, False])
def test_a_robot_that_is_lost_does_not_go_by_its_map_any_more(maps):
    localiser = located(sigma_m=0.03, sigma_rad=0.01, maps=maps)
    localiser.move(FORWARD)
    localiser.see(ROOM.points(localiser.pose), local_map(ROOM_MAP, variances=(0.04, 0.09, 0.01)))
    before = localiser.covariance
    localiser.lose("it was carried")
    assert localiser.lost == "it was carried"
    if maps:
        assert localiser.covariance == pytest.approx(np.diag((0.02**2, 0.02**2, 0.01**2))), "in its own frame"
    else:
        assert np.diag(localiser.covariance - before) == pytest.approx((25.0, 25.0, (math.pi / 2) ** 2))
    assert np.array_equal(localiser.covariance, localiser.filter.covariance)
    assert localiser.driven_m == 0.0


def set_down(x_m, turn_rad=0.0, *, sigma_m=0.03):
    """A robot that is set down elsewhere in its room; scans are refused until it doubts its place enough."""
    localiser = located(sigma_m=sigma_m, sigma_rad=0.02, watch=DivergenceSpec(misfits_max=1000))
    truth, refused = beside(TRUE, x_m, 0.0, turn_rad), 0
    while True:
        localiser.move(Twist2D(1e-9, 0.0, 0.1))
        truth = beside(truth, 0.0, 0.0, 0.1)
        localiser.see(ROOM.points(truth), local_map(ROOM_MAP))
        if localiser.fits:
            return localiser, refused
        refused += 1
        assert refused < 50


@pytest.mark.parametrize(("x_m", "is_lost"), [(0.2, False), (0.28, False), (0.35, True), (-0.35, True)])
def test_who_fits_only_a_good_way_off_where_the_wheels_say_has_been_carried(x_m, is_lost):
    localiser, refused = set_down(x_m, 0.1)
    assert refused > 0 or is_lost
    assert ("off where the wheels have it" in localiser.lost) == is_lost


GATE = 10.0


def watch(**spec):
    return DivergenceMonitor(DivergenceSpec(**{"window": 4, "nis_max": 2.5, "refused_max": 0.5, **spec}), GATE)


@pytest.mark.parametrize(("nis", "is_too_large"), [(2.5, False), (2.6, True)])
def test_the_mean_over_the_window_may_be_as_large_as_said(nis, is_too_large):
    one = watch()
    whys = [one.check_signal(nis) for _ in range(4)]
    assert bool(whys[-1]) == is_too_large
    assert one.mean_nis == pytest.approx(nis)
    assert one.refused == 0


def test_only_the_last_measurements_count():
    one = watch()
    for nis in (9.0, 9.0, 1.0, 1.0, 1.0):
        one.check_signal(nis)
    assert one.check_signal(1.0) == ""
    assert one.mean_nis == 1.0


@pytest.mark.parametrize(("refused", "is_too_many"), [(2, False), (3, True)])
def test_the_gate_may_refuse_as_many_as_said(refused, is_too_many):
    one = watch(nis_max=100.0)
    whys = [one.check_signal(99.0 if number < refused else 0.0) for number in range(4)]
    assert bool(whys[-1]) == is_too_many
    assert one.refused == refused
    assert one.mean_nis == pytest.approx(refused * GATE / 4), "one that was refused counts as the gate"
    assert not is_too_many or f"{refused} of the last 4" in whys[-1]


def test_scans_in_a_row_that_do_not_fit_are_counted():
    one = watch(misfits_max=3, fit_min=0.4)
    assert [bool(one.check_scan(fit)) for fit in (0.3, 0.3, 0.4, 0.3, 0.3)] == [False] * 5
    assert one.check_scan(0.399).startswith("3 scans in a row")
    assert one.check_scan(0.3).startswith("4 scans in a row")
    assert one.check_scan(0.4) == ""


def test_scans_that_did_not_fit_before_the_frame_was_found_do_not_count_after() -> None:
    localiser = located(watch=DivergenceSpec(misfits_max=3))
    lost = []
    for turn in range(5):
        if turn == 2:
            localiser.join()
        localiser.see(ROOM.points(ELSEWHERE), local_map(ROOM_MAP))
        assert not localiser.fits or localiser.lost
        lost.append(bool(localiser.lost))
    assert lost == [False, False, False, False, True]


@pytest.mark.parametrize(
    ("wrong", "sigma_m", "sigma_rad", "is_found"),
    [
        ((0.5, -0.3, 0.0), 0.25, 0.03, True),
        ((0.5, -0.3, 0.0), 0.19, 0.03, False),
        ((0.0, 0.0, 0.4), 0.1, 0.2, True),
        ((0.0, 0.0, 0.4), 0.1, 0.059, False),
        ((0.0, 1.3, 0.0), 0.25, 0.03, False),  # beyond three standard deviations
    ],
)
def test_a_place_less_sure_than_two_decimetres_or_a_yaw_less_sure_than_three_degrees_is_looked_for(
    wrong, sigma_m, sigma_rad, is_found
):
    localiser = located(beside(TRUE, *wrong), sigma_m=sigma_m, sigma_rad=sigma_rad)
    localiser.see(ROOM.points(TRUE), local_map(ROOM_MAP))
    assert (at(localiser, TRUE) == pytest.approx((0.0, 0.0, 0.0), abs=0.03)) == is_found
