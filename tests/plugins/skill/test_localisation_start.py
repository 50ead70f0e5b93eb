"""A robot compares its first scans with its team's map: whether its start is right, and later how well they fit."""

import math

import numpy as np
import pytest

from robrain.algorithms.localization.odometry import moved_along
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.mapping.local_map import NO_DRIFT, NONE, LocalMap, OwnMap
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.plugins.skill.localisation import PAUSE_M, PAUSE_RAD
from robrain.protocol.can.frames import codec
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D, Twist2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from robrain.protocol.model.map_frame import ARENA, MapFrame

GEOMETRY = GridGeometry(0.1, -8.0, -8.0, 160, 160)
GRID = {"resolution_m": 0.1, "origin_x_m": -8.0, "origin_y_m": -8.0, "width_m": 16.0, "height_m": 16.0}
SQUARE_M = [min(2.0 / max(abs(math.cos(a)), abs(math.sin(a))), 5.0) for a in np.linspace(-np.pi, np.pi, 361)[:-1]]


def room_of_others(half_m=2.0):
    """A square room about the origin that the others know, in one statement."""
    cells = np.full((60, 60), FREE, np.int8)
    wall = round(half_m / 0.1)
    inner = np.s_[30 - wall : 30 + wall, 30 - wall : 30 + wall]
    around = np.full((60, 60), OCCUPIED, np.int8)
    around[inner] = cells[inner]
    grid = OccupancyGrid(GEOMETRY)
    grid.merge_patch(50, 50, around, 5)
    return grid


def started(stage, **parameters):
    one = stage()
    host = one.host("localisation", localisation=parameters)
    return one, host


def standing(one, seconds, ranges_m=SQUARE_M):
    one.run(seconds, lambda: one.stand_and_scan(ranges_m))


@pytest.mark.parametrize(("half_m", "is_lost"), [(2.0, False), (1.0, True)])
def test_a_robot_that_does_not_see_what_the_others_have_mapped_there_started_elsewhere(stage, half_m, is_lost):
    one, host = started(stage)
    events = one.inbox(ROBOT_EVENT, robot="r1", plugin="localisation", event="diverged")
    host.board.shared(OwnMap).map_of_others = room_of_others(half_m)
    standing(one, 0.3)
    assert bool(host.board.lost) == host.board.shared(OwnMap).false_start == is_lost
    said = [received.message.value for received in events.drain()]
    assert [each["is_lost"] for each in said] == [True] * is_lost
    assert all("on the map of the others" in each["why"] for each in said)


@pytest.mark.parametrize(("beams", "is_told"), [(0, False), (1, True), (90, True)])
def test_whoever_sees_a_wall_tells_how_well_it_fits_the_teams_map(stage, beams, is_told):
    one = stage()
    host = one.host("localisation", "mapper", mapper=GRID)
    standing(one, 1.0)
    host.board.map_agreement = None
    standing(one, 2.0, [2.0] * beams or [0.0] * 90)
    assert (host.board.map_agreement is not None) == is_told


def walls_at(T_arena_local):
    """The robot's own map of the square room, and where that lies."""
    grid = OccupancyGrid(GEOMETRY, surfaces=True)
    angles_rad = np.linspace(-np.pi, np.pi, 361)[:-1]
    grid.integrate_scan(IDENTITY, angles_rad, np.array(SQUARE_M), 6.0, 1, np.empty((0, 3)))
    return LocalMap(grid, T_arena_local, IDENTITY, NONE, NO_DRIFT, 1, 1, 0)


MOTES = [Point2D(float(x), float(y)) for x in (-2, 5, 12) for y in (-3, 4, 11)]
LOSS = PathLoss(shadowing_db=1.0, fading_db=1.0)
BASE, STEP = OmniBase(), Twist2D(0.05, 0.0, 0.015)


def drive_past_motes(one, host):
    """Drive a curve of 6 m somewhere among motes; where that ends."""
    bus, counts, true = one.bus(), [0.0, 0.0, 0.0], Pose2D(3.0, 6.0, 1.0)
    for step in range(120):
        for wheel, turn_rad in enumerate(BASE.wheel_speeds_rad_s(STEP)):
            counts[wheel] += turn_rad / BASE.rad_per_tick
        ticks = {f"wheel_{wheel}_ticks": round(count) % 65536 for wheel, count in enumerate(counts, 1)}
        bus.send(codec("WheelEncoders").pack(step, **ticks))
        true = moved_along(true, STEP)
        if step % 2:
            mote = MOTES[step // 2 % len(MOTES)]
            rssi_dbm = LOSS.mean_dbm(math.hypot(true.x_m - mote.x_m, true.y_m - mote.y_m))
            host.board.mote_ranges.append(RssiSample(f"m{step // 2 % len(MOTES)}", mote, rssi_dbm))
        one.run(0.02)
    one.run(0.2)
    return true


def unknown_start(stage):
    return started(stage, start_known=False, path_loss={"shadowing_db": 1.0, "fading_db": 1.0})


def test_motes_tell_a_lost_robot_where_the_frame_that_it_maps_in_lies(stage):
    one, host = unknown_start(stage)
    lost = host.board.lost
    host.board.shared(OwnMap).local_map = walls_at(IDENTITY)._replace(
        trajectory=1, frame=MapFrame(20, "r1"), reason=lost
    )
    true = drive_past_motes(one, host)
    fix = host.board.shared(OwnMap).arena_fix
    assert fix.trajectory == 1
    assert fix.at.distance_m(true) < 0.5
    assert fix.T_arena_frame.compose(host.board.pose).distance_m(true) < 0.3
    assert host.board.shared(OwnMap).may_be_at(true)
    assert not host.board.shared(OwnMap).may_be_at(Pose2D(true.x_m + 6.0, true.y_m - 5.0, true.yaw_rad))
    assert host.board.lost == lost, "until the mapper has moved its map there"
    assert host.board.pose.distance_m(true) > 3.0


def test_a_lost_robot_that_has_mapped_nothing_is_where_motes_tell(stage):
    one, host = unknown_start(stage)
    true = drive_past_motes(one, host)
    assert host.board.lost == ""
    assert host.board.shared(OwnMap).arena_fix is None
    assert host.board.pose.distance_m(true) < 0.5
    assert host.board.shared(OwnMap).local_pose.trajectory == 2, "its map begins where it was found"


OWN = MapFrame(20, "r1")


def in_frame(T_arena_local, trajectory=0, frame=ARENA, why=""):
    grid = OccupancyGrid(GEOMETRY, surfaces=True)
    return LocalMap(grid, T_arena_local, IDENTITY, NONE, NO_DRIFT, 1, 1, trajectory, frame, why)


def localised(stage, *load, **parameters):
    one = stage()
    host = one.host("localisation", *load, mapper=GRID, localisation=parameters)
    return one, host, host.manager.get("localisation").plugin


def off(pose, other):
    turned_rad = math.remainder(pose.yaw_rad - other.yaw_rad, math.tau)
    return pose.x_m - other.x_m, pose.y_m - other.y_m, turned_rad


@pytest.mark.parametrize(
    ("covariance", "sigma_m", "sigma_rad"),
    [
        (np.diag((0.04, 0.09, 0.01)).ravel(), 0.3 + PAUSE_M, 0.1 + PAUSE_RAD),
        (np.diag((0.09, 0.04, 0.01)).ravel(), 0.3 + PAUSE_M, 0.1 + PAUSE_RAD),
        ((), 0.2, 0.1),
        ((0.04,) * 8, 0.2, 0.1),
    ],
)
def test_after_a_pause_the_robot_is_where_it_was_but_less_sure_or_where_it_was_told(
    stage, covariance, sigma_m, sigma_rad
):
    told = {"x_m": 3.0, "y_m": -1.0, "yaw_rad": 0.5, "start_sigma_m": 0.2, "start_sigma_rad": 0.1}
    host = stage().host("localisation", start=False, localisation=told)
    is_known = len(covariance) == 9
    host.board.T_arena_odom = before = Pose2D(50.0, 0.0, 0.25)
    host.board.pose_covariance = tuple(float(each) for each in covariance)
    host.start()
    localisation = host.manager.get("localisation").plugin
    assert localisation.pose() == (before if is_known else Pose2D(3.0, -1.0, 0.5))
    assert localisation.health().sigma_m == pytest.approx(sigma_m)
    assert localisation.health().sigma_rad == pytest.approx(sigma_rad)


MOVED = Pose2D(0.3, -0.2, 0.4)


def test_a_lost_robot_moves_with_the_map_in_its_own_frame_and_is_found_when_that_lies_in_the_arena(stage):
    one, host, localisation = localised(stage, start_known=False, x_m=2.0)
    lost = host.board.lost
    host.board.shared(OwnMap).local_map = in_frame(MOVED, trajectory=1, frame=OWN, why=lost)
    one.run(0.2)
    moved = MOVED.compose(Pose2D(2.0, 0.0, 0.0))
    assert off(localisation.pose(), moved) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert host.board.lost == host.board.shared(OwnMap).local_pose.lost == lost
    host.board.shared(OwnMap).local_map = in_frame(IDENTITY, trajectory=1)
    one.run(0.2)
    assert localisation.pose().x_m == pytest.approx(2.0)
    assert host.board.lost == host.board.shared(OwnMap).local_pose.lost == ""
    assert host.board.shared(OwnMap).local_pose.trajectory == 1, "its map goes on"


def test_a_robot_whose_map_leaves_the_arena_frame_is_lost_for_the_same_reason_and_stays_where_it_is(stage):
    one, host, localisation = localised(stage, x_m=2.0)
    host.board.shared(OwnMap).local_map = in_frame(IDENTITY, frame=OWN, why="mates contradict it")
    one.run(0.2)
    assert host.board.lost == "mates contradict it"
    assert localisation.pose() == Pose2D(2.0, 0.0, 0.0)
    assert host.board.shared(OwnMap).local_pose.trajectory == 0
    assert localisation.health().sigma_m < 0.1


def test_a_robot_whose_map_lies_wrong_begins_another(stage):
    one, host, _ = localised(stage, "mapper")
    standing(one, 1.0)
    trajectory = host.board.shared(OwnMap).local_pose.trajectory
    host.board.shared(OwnMap).misplaced = "mates contradict"
    standing(one, 0.3)
    assert (host.board.shared(OwnMap).misplaced, host.board.lost) == ("", "mates contradict")
    assert host.board.shared(OwnMap).local_pose.trajectory == trajectory + 1
    standing(one, 1.0)
    assert host.board.shared(OwnMap).local_map.trajectory == trajectory + 1
    assert host.board.frame != ARENA
