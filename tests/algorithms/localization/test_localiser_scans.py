"""What scans may do to a robot's place: the gate, the floor of the covariance, and what is honest to say."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.localiser import (
    REFUSED_SIGMA_M,
    DivergenceSpec,
    Localiser,
    LocaliserSpec,
)
from robrain.algorithms.localization.rssi_ranging import RssiSample
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from tests.algorithms.mapping.lidar_floor import CORRIDOR, CORRIDOR_PLACES, GEOMETRY, ROOM, ROOM_PLACES, local_map

TRUE = Pose2D(2.3, 4.1, 0.8)
ROOM_MAP = ROOM.mapped(*ROOM_PLACES)
NOTHING = OccupancyGrid(GEOMETRY, surfaces=True)
FORWARD = Twist2D(0.05, 0.0, 0.0)


def located(believed=TRUE, sigma_m=0.1, sigma_rad=0.03, **spec):
    return Localiser(believed, sigma_m, sigma_rad, LocaliserSpec(**spec))


def beside(pose, x_m, y_m=0.0, turn_rad=0.0):
    return Pose2D(pose.x_m + x_m, pose.y_m + y_m, pose.yaw_rad + turn_rad)


def off(localiser, pose):
    return (
        localiser.pose.x_m - pose.x_m,
        localiser.pose.y_m - pose.y_m,
        math.remainder(localiser.pose.yaw_rad - pose.yaw_rad, math.tau),
    )


@pytest.mark.parametrize("bearing_rad", [0.0, 1.5, -2.2])
@pytest.mark.parametrize(("off_m", "is_believed"), [(0.235, True), (0.258, False)])
def test_a_scan_that_lies_farther_off_than_one_in_a_thousand_is_refused(bearing_rad, off_m, is_believed):
    """The gate of three directions is 16.27: four times 0.06 m, and what walls are off by."""
    believed = beside(TRUE, off_m * math.cos(bearing_rad), off_m * math.sin(bearing_rad))
    localiser = located(believed, sigma_m=0.06, sigma_rad=0.01, search_m=1.0)
    localiser.see(ROOM.points(TRUE), local_map(ROOM_MAP))
    assert localiser.fits == is_believed
    if is_believed:
        assert off(localiser, TRUE) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    else:
        assert off(localiser, believed) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
        assert localiser.filter.sigma_m == pytest.approx(math.hypot(0.06, REFUSED_SIGMA_M)), "but the robot doubts"


@pytest.mark.parametrize(("off_m", "is_believed"), [(0.213, True), (0.24, False)])
def test_in_a_corridor_the_gate_is_that_of_two_directions(off_m, is_believed):
    true = Pose2D(6.0, 4.0, 0.2)
    localiser = located(beside(true, 0.0, off_m), sigma_m=0.06, sigma_rad=0.01)
    localiser.see(CORRIDOR.points(true), local_map(CORRIDOR.mapped(*CORRIDOR_PLACES)))
    assert localiser.fits == is_believed


@pytest.mark.parametrize(("off_m", "is_believed"), [(0.17, True), (0.2, False)])
def test_what_walls_may_be_off_by_counts_in_the_gate(off_m, is_believed):
    """0.03 m of the robot and 0.03 m of the walls, which err together: 0.045 m in all."""
    localiser = located(beside(TRUE, off_m), sigma_m=0.03, sigma_rad=0.01, wall_sigma_m=0.03)
    localiser.move(Twist2D(1e-9, 0.0, 0.1))
    localiser.see(ROOM.points(beside(TRUE, 0.0, 0.0, 0.1)), local_map(ROOM_MAP))
    assert localiser.fits == is_believed


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


@pytest.mark.parametrize(("path_m", "is_matched"), [(0.0199, False), (0.0201, True)])
def test_a_sure_robot_is_matched_after_two_centimetres(path_m, is_matched):
    localiser = located(sigma_m=0.04, sigma_rad=0.01)
    localiser.move(Twist2D(path_m, 0.0, 0.0))
    true = beside(localiser.pose, 0.01)
    before = localiser.pose
    for _ in range(2):
        localiser.see(ROOM.points(true), local_map(ROOM_MAP))
    assert (max(map(abs, off(localiser, before))) > 1e-9) == is_matched
    assert localiser.fits


@pytest.mark.parametrize(("sigma_m", "is_matched"), [(0.049, False), (0.051, True)])
def test_an_unsure_robot_is_matched_though_it_stands(sigma_m, is_matched):
    localiser = located(sigma_m=sigma_m, sigma_rad=0.01)
    localiser.see(ROOM.points(beside(TRUE, 0.01)), local_map(ROOM_MAP))
    assert (max(map(abs, off(localiser, TRUE))) > 1e-9) == is_matched


@pytest.mark.parametrize(
    ("steps", "path_m"),
    [
        ([Twist2D(0.3, 0.4, 0.0)], 0.5),
        ([Twist2D(0.0, 0.0, 1.0)], 0.3),
        ([Twist2D(-0.2, 0.0, -1.0)], 0.5),
        ([FORWARD] * 4, 0.2),
    ],
)
def test_way_is_that_of_the_wheels_and_turns_count_too(steps, path_m):
    localiser = located()
    for step in steps:
        localiser.move(step)
    assert localiser.driven_m == pytest.approx(path_m)


@pytest.mark.parametrize(("step_m", "counted_m"), [(0.2, 0.2), (1.0, 1.0), (3.0, 1.0)])
def test_between_two_scans_the_odometry_goes_wrong_by_more_than_its_states_can_follow(step_m, counted_m):
    localiser, other = located(), located()
    for _ in range(2):
        for each in (localiser, other):
            each.move(Twist2D(step_m, 0.0, 0.0))
        before = localiser.filter.covariance
        localiser.see(np.empty((0, 2)), local_map(NOTHING))
        added = np.diag(localiser.filter.covariance - before)
        assert added == pytest.approx(((0.05 * counted_m) ** 2, (0.05 * counted_m) ** 2, (0.1 * counted_m) ** 2))
    localiser.see(np.empty((0, 2)), local_map(NOTHING))
    assert np.array_equal(np.diag(localiser.filter.covariance - before), added), "it has not moved since"


@settings(deadline=None, max_examples=30)
@given(st.floats(0.0, 0.3), st.floats(0.0, 0.3), st.floats(0.0, 0.2))
def test_drift_is_what_the_robot_is_less_sure_of_than_a_match_leaves(x_m, y_m, yaw_rad):
    localiser = located(sigma_m=1e-3, sigma_rad=1e-3)
    localiser.filter.add((x_m**2, y_m**2, yaw_rad**2))
    m2, rad2 = localiser.drift
    own_m2, own_rad2 = 0.5 * (x_m**2 + y_m**2) + 1e-6, yaw_rad**2 + 1e-6
    assert m2 == pytest.approx(max(own_m2 - 0.03**2, 0.0) + min(0.01**2, own_m2))
    assert rad2 == pytest.approx(max(own_rad2 - 0.005**2, 0.0) + min(0.002**2, own_rad2))


def test_each_time_the_robot_goes_by_walls_that_were_drawn_surer_it_gets_surer_and_never_by_itself():
    """A chain of walls, each drawn with the drift of the ones before, makes nobody surer than the first."""
    localiser = located(sigma_m=0.03, sigma_rad=0.005)
    drifts = []
    for drift in ((0.01, 1e-4), (0.04, 4e-4), (0.02, 2e-4)):
        localiser.move(FORWARD)
        grid = ROOM.mapped(*ROOM_PLACES, drift=drift)
        localiser.see(ROOM.points(localiser.pose), local_map(grid))
        drifts.append(localiser.drift)
    for drift, m2, rad2 in zip(drifts, (0.01, 0.04, 0.02), (1e-4, 4e-4, 2e-4), strict=True):
        assert drift[0] == pytest.approx(m2 + 1e-4, rel=0.1)
        assert drift[1] == pytest.approx(rad2 + 4e-6, rel=0.2)


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
    assert (off(localiser, TRUE) == pytest.approx((0.0, 0.0, 0.0), abs=0.03)) == is_found


@pytest.mark.parametrize("axis", [0, 1])
def test_how_unsure_the_map_is_counts_in_the_worst_direction(axis):
    variances = [1e-4, 1e-4, 0.0]
    variances[axis] = 0.16
    localiser = located(sigma_m=0.03)
    localiser.see(ROOM.points(TRUE), local_map(ROOM_MAP, variances=tuple(variances)))
    assert localiser.sigma_m == pytest.approx(math.sqrt(0.03**2 + 0.16), rel=1e-3)


def test_a_robot_whose_map_is_unsure_listens_to_motes_less():
    shifts_m = []
    for variance_m2 in (1e-6, 4.0):
        localiser = located(sigma_m=0.3)
        localiser.see(np.empty((0, 2)), local_map(NOTHING, variances=(variance_m2, variance_m2, 0.0)))
        mote = Point2D(TRUE.x_m + 3.0, TRUE.y_m)
        localiser.receive(RssiSample("m", mote, localiser.spec.path_loss.mean_dbm(3.0) + 3.0))
        shifts_m.append(abs(off(localiser, TRUE)[0]))
    assert shifts_m[1] < 0.8 * shifts_m[0]


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
