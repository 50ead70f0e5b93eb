import math

import msgspec
import numpy as np
import pytest

from robrain.algorithms.mapping.local_map import NO_DRIFT, LocalPose, OwnMap
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid, PatchCells
from robrain.algorithms.slam.map_patch import merge_message, to_message
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.can.frames import codec
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, MapPatch
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN, Scan
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.ranges import STAMP_MAX

GRID = {"resolution_m": 0.1, "origin_x_m": -8.0, "origin_y_m": -8.0, "width_m": 16.0, "height_m": 16.0}


def view(host):
    return host.manager.get("mapper").plugin.view()


def drive(host, *places):
    """Send a robot along these places, arena frame."""
    localisation = host.manager.get("localisation").plugin
    host.manager.get("driver").plugin.follow(localisation.to_odom([Point2D(*place) for place in places]))


def class_at(seen, x_m, y_m):
    return seen.classes[seen.geometry.cell_of(x_m, y_m)]


def ghosts(seen, plan):
    """Places that the map says are occupied though no wall is within 0.2 m."""
    found = []
    for row, column in np.argwhere(seen.classes == OCCUPIED):
        place = seen.geometry.center_of(int(row), int(column))
        cell = plan.cell_of(place.x_m, place.y_m)
        if plan.holds_cell(*cell) and plan.clearance_m[cell] > 0.2:
            found.append((place.x_m, place.y_m))
    return found


def lies_at(T_local_odom, sigma_m=0.03):
    """What localisation would say: scans may be mapped as they come."""
    return LocalPose(T_local_odom, 0, NO_DRIFT, STAMP_MAX, True, sigma_m)


def mapping(stage, *others):
    """A robot that maps, and its host."""
    one = stage()
    return one, one.host("mapper", *others, mapper=GRID)


def test_a_room_of_known_size_is_mapped_as_such(stage):
    one, host = mapping(stage, "localisation")
    ranges_m = [min(2.0 / max(abs(math.cos(a)), abs(math.sin(a))), 5.0) for a in np.linspace(-np.pi, np.pi, 721)[:-1]]
    one.run(1.0, lambda: one.stand_and_scan(ranges_m))
    seen = view(host)
    for place in ((0.0, 0.0), (1.8, 0.0), (-1.5, -1.5)):
        assert class_at(seen, *place) == FREE
    for place in ((2.05, 0.0), (-2.05, 1.0), (0.5, 2.05)):
        assert class_at(seen, *place) == OCCUPIED
    for place in ((2.5, 0.0), (-3.0, -3.0), (0.0, 7.0)):
        assert class_at(seen, *place) == UNKNOWN


def test_a_scan_is_put_where_the_robot_was_when_it_was_made(stage):
    one, host = mapping(stage, "localisation")
    bus, counts = one.bus(), iter(range(0, 30000, 200))

    def turn():
        ticks = next(counts)
        bus.send(codec("WheelEncoders").pack(0, wheel_1_ticks=ticks, wheel_2_ticks=ticks, wheel_3_ticks=ticks))

    one.run(0.02, turn)
    stamp_ns = one.clock.now_ns()
    one.run(0.4, turn)
    assert host.manager.get("localisation").plugin.pose().yaw_rad > 1.0
    late = Scan(
        robot="r1", stamp_ns=stamp_ns, angle_min_rad=0.0, angle_increment_rad=1.0, range_max_m=6.0, ranges_mm=[3000]
    )
    one.publisher(ARENA_SCAN, robot="r1").put_bytes(msgspec.json.encode(late))
    one.run(0.6)
    assert class_at(view(host), 3.02, 0.0) == OCCUPIED
    assert view(host).classes[:, view(host).geometry.cell_of(1.0, 0.0)[1]].tolist().count(FREE) == 1


def test_two_robots_end_with_one_map(stage, room):
    plan = room(8.0, 4.0, (3.9, 0.0, 4.1, 2.6))
    one = stage(plan, r1=Pose2D(1.0, 1.0, 0.0), r2=Pose2D(7.0, 1.0, 0.0))
    hosts = [one.host("mapper", "localisation", robot=robot) for robot in ("r1", "r2")]
    one.run(3.0)
    maps = [view(host).classes for host in hosts]
    assert np.array_equal(maps[0], maps[1])
    assert class_at(view(hosts[0]), 7.0, 1.5) == FREE  # behind the wall: known by the other's word


def test_one_who_joins_late_has_the_whole_map(stage, room):
    plan = room(8.0, 4.0, (3.9, 0.0, 4.1, 2.6))
    one = stage(plan, r1=Pose2D(1.0, 1.0, 0.0), r2=Pose2D(7.0, 1.0, 0.0))
    first = one.host("mapper", "localisation")
    one.run(3.0)
    before = view(first).classes
    assert class_at(view(first), 7.0, 1.5) == UNKNOWN
    late = one.host("mapper", "localisation", robot="r2")
    known = before != UNKNOWN
    # Zenoh tells of tokens that were there before on a thread of its own, a little later.
    one.run_until(lambda: np.array_equal(view(late).classes[known], before[known]), 60.0)


def test_a_map_on_another_grid_is_refused_with_one_word_in_the_log(stage, caplog):
    one, host = mapping(stage, "localisation")
    patch = MapPatch(
        robot="r2",
        resolution_m=0.05,
        origin_x_m=0.0,
        origin_y_m=0.0,
        width=4,
        height=4,
        row=0,
        column=0,
        rows=1,
        columns=1,
        observed_ms=5,
        cells=b"",
    )
    one.wire.token(ROBOT_ALIVE, robot="r2")
    for _ in range(3):
        one.publisher(ROBOT_MAP, robot="r2").put(patch)
        one.run(0.6)
    assert not np.any(view(host).classes != UNKNOWN)
    refused = [record.getMessage() for record in caplog.records if "cannot be merged" in record.getMessage()]
    assert len(refused) == 1
    assert "r2 maps" in refused[0]
    mapper = host.manager.get("mapper").plugin
    assert [(each.topic, each.code, each.count) for each in mapper.env.wire.refusals.counts()] == [
        ("robot_map", "not_plausible", 3)
    ]
    assert one.infos()["mapper"].state == "active"


def test_scans_are_left_out_while_the_place_is_not_sure_and_taken_in_again_later(stage):
    one, host = mapping(stage)
    paused = one.inbox(ROBOT_EVENT, robot="r1", plugin="mapper", event="paused")
    board = host.board
    board.shared(OwnMap).local_pose = lies_at(Pose2D(0.0, 0.0, 0.0), sigma_m=3.0)
    board.pose_covariance = (9.0, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.01)
    one.run(1.0, lambda: one.stand_and_scan([2.0] * 90))
    assert not np.any(view(host).classes != UNKNOWN)
    assert one.call("mapper", "counters")["scans_skipped"] > 10
    # Where the own map lies in the arena may be as unsure as it likes: closures move it, and only who maps finds any.
    board.shared(OwnMap).local_pose = lies_at(Pose2D(0.0, 0.0, 0.0))
    one.run(1.0, lambda: one.stand_and_scan([2.0] * 90))
    assert np.any(view(host).classes == OCCUPIED)
    said = [received.message.value for received in paused.drain()]
    assert len(said) == 2
    assert "not sure enough" in said[0]
    assert said[1] == ""


def test_after_a_correction_walls_are_put_where_they_are_in_the_arena(stage):
    """Cells are the arena's: what is mapped after T_local_odom has jumped is not shifted with the odometry's frame."""
    one, host = mapping(stage)
    patches = one.inbox(ROBOT_MAP)
    host.board.pose_covariance = (1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-5)
    host.board.shared(OwnMap).local_pose = lies_at(Pose2D(0.0, 0.0, 0.0))
    one.run(1.0, lambda: one.stand_and_scan([3.0]))  # one ray, backwards
    host.board.shared(OwnMap).local_pose = lies_at(Pose2D(0.0, 1.0, math.pi))
    one.run(1.0, lambda: one.stand_and_scan([3.0]))
    seen = view(host)
    assert class_at(seen, -3.02, 0.0) == OCCUPIED
    assert class_at(seen, 3.02, 1.0) == OCCUPIED
    elsewhere = SubmapAtlas(seen.geometry)
    for received in patches.drain():
        merge_message(elsewhere, received.message)
    assert np.array_equal(elsewhere.grid.classes(), seen.classes)


def test_memory_is_bounded_whatever_the_others_send_and_drops_are_counted(stage):
    one, host = mapping(stage, "localisation")
    grid = GridGeometry(0.1, -8.0, -8.0, 160, 160)
    other = OccupancyGrid(grid)
    other.merge_patch(0, 0, np.full((2, 2), FREE, np.int8), 1)
    patch, publisher = (
        to_message("r2", grid, PatchCells(0, 0, other.classes(), int(other.stamp_ms.max()))),
        one.publisher(ROBOT_MAP, robot="r2"),
    )
    for _ in range(4096 + 100):
        publisher.put(patch)
    one.run(0.6)
    assert one.call("mapper", "counters")["patches_dropped"] == 100
    assert view(host).classes.shape == grid.shape


def hall(robot, observed_ms):
    """A patch of 4 × 4 m of floor."""
    grid = GridGeometry(0.1, -8.0, -8.0, 160, 160)
    other = OccupancyGrid(grid)
    other.merge_patch(0, 0, np.full((40, 40), FREE, np.int8), observed_ms)
    return to_message(robot, grid, PatchCells(0, 0, other.classes(), int(other.stamp_ms.max())))


WRAPPED_MS = 2**31 - 1
"""A millisecond before 0, as times in patches have 31 bits."""


@pytest.mark.parametrize(("observed_ms", "is_taken"), [(500, True), (5_900, True), (20_000, False), (WRAPPED_MS, True)])
def test_patches_from_the_future_are_ignored(stage, observed_ms, is_taken):
    one, host = mapping(stage, "localisation")
    one.wire.token(ROBOT_ALIVE, robot="r2")
    one.run(1.0)
    one.publisher(ROBOT_MAP, robot="r2").put(hall("r2", observed_ms))
    one.run(0.6)
    assert np.any(view(host).classes == FREE) == is_taken
    assert one.infos()["mapper"].state == "active"


def test_patches_of_an_absent_robot_are_ignored_until_it_is_there(stage):
    one, host = mapping(stage, "localisation")
    one.run(1.0)
    for is_taken in (False, True):
        one.publisher(ROBOT_MAP, robot="r2").put(hall("r2", 500))
        one.run(0.6)
        assert np.any(view(host).classes == FREE) == is_taken
        one.wire.token(ROBOT_ALIVE, robot="r2")
        one.run(0.6)


def test_what_a_mate_took_for_a_wall_is_floor_again_once_the_robot_sees_through_it(stage):
    """As where somebody stood for a moment, whom only the mate saw."""
    one, host = mapping(stage, "localisation")
    one.wire.token(ROBOT_ALIVE, robot="r2")
    one.run(2.0, lambda: one.stand_and_scan([2.0] * 360))
    geometry = view(host).geometry
    row, column = geometry.cell_of(1.0, 0.0)
    wall = PatchCells(row, column, np.array([[OCCUPIED]]), 2_000)
    one.publisher(ROBOT_MAP, robot="r2").put(to_message("r2", geometry, wall))
    one.run(5.0, lambda: one.stand_and_scan([2.0] * 360))
    assert class_at(view(host), 1.0, 0.0) == FREE


START = Pose2D(1.0, 1.0, 0.0)
BLOCKS = ((2.8, 2.2, 3.6, 2.8), (5.6, 2.1, 6.2, 3.4), (7.8, 0.0, 8.1, 1.6), (0.0, 3.6, 1.5, 3.8))


def ghosts_of(host, plan, *, body=None, moved=IDENTITY):
    """Places that a map calls occupied though no wall is within 0.2 m, nor a robot's `body`.

    `moved` is how the frame of the map lies in the arena.
    """
    seen, found = view(host), []
    for row, column in np.argwhere(seen.classes == OCCUPIED):
        middle = seen.geometry.center_of(int(row), int(column))
        place = moved.compose(Pose2D(middle.x_m, middle.y_m, 0.0))
        cell = plan.cell_of(place.x_m, place.y_m)
        is_body = body is not None and body.distance_m(Pose2D(place.x_m, place.y_m, 0.0)) < 0.4
        if plan.holds_cell(*cell) and plan.clearance_m[cell] > 0.2 and not is_body:
            found.append((place.x_m, place.y_m))
    return found


def drive_to(one, host, *places, robot="r1"):
    localisation = host.manager.get("localisation").plugin
    for place in places:
        host.manager.get("driver").plugin.follow(localisation.to_odom([Point2D(*place)]))
        one.run_until(lambda place=place: one.truth(robot).pose.distance_m(Pose2D(*place, 0.0)) < 0.15, 30.0)
    one.run(1.0)


def stroll(one, host, *places, robot="r1"):
    """Drive a robot that does not know where it is: places in the arena, by the truth."""
    driver = host.manager.get("driver").plugin
    for place in places:
        T_odom_arena = driver.pose().compose(one.truth(robot).pose.inverse())
        target = T_odom_arena.compose(Pose2D(*place, 0.0))
        driver.follow([Point2D(target.x_m, target.y_m)])
        one.run_until(lambda place=place: one.truth(robot).pose.distance_m(Pose2D(*place, 0.0)) < 0.15, 30.0)
    one.run(3.0)


@pytest.fixture
def restarted(stage, room):
    """A stage, its plan, the host of r1 that restarted 5 m from its start, and that of r2, which saw all of it."""
    plan = room(10.0, 5.0, *BLOCKS)
    one = stage(plan, r1=START, r2=Pose2D(1.0, 2.5, 0.0))
    first, mate = (one.host("mapper", "localisation", robot=robot) for robot in ("r1", "r2"))
    drive_to(one, first, (4.6, 1.0), (4.6, 3.9), (6.8, 4.2), (4.6, 3.9))
    one.hosts.remove(first)
    first.close()
    one.run(0.5)
    events = one.inbox(ROBOT_EVENT, robot="r1", plugin="localisation", event="diverged")
    again = one.host("mapper", "localisation")
    return one, plan, again, mate, events


@pytest.mark.slow
def test_a_robot_begun_anew_away_from_its_start_says_at_once_that_it_is_lost_and_finds_itself(restarted):
    one, _, again, _, events = restarted
    assert again.manager.get("localisation").plugin.pose().distance_m(one.truth().pose) > 4.0
    one.run(1.0)
    assert again.board.lost
    stroll(one, again, (4.6, 2.6), (4.2, 3.6))
    said = [received.message.value for received in events.drain()]
    assert [each["is_lost"] for each in said] == [True, False]
    assert "on the map of the others" in said[0]["why"]
    found = again.manager.get("localisation").plugin.pose()
    assert found.distance_m(one.truth().pose) < 0.1
    assert found.yaw_rad == pytest.approx(one.truth().pose.yaw_rad, abs=0.05)


@pytest.mark.slow
def test_a_robot_whose_start_is_not_known_is_lost_until_the_walls_on_its_teams_map_find_it(stage, room):
    plan = room(10.0, 5.0, *BLOCKS)
    one = stage(plan, r1=START, r2=Pose2D(6.8, 4.2, -1.0))
    first = one.host("mapper", "localisation")
    drive_to(one, first, (4.6, 1.0), (4.6, 3.9), (4.6, 1.0))
    late = one.host("mapper", "localisation", robot="r2", localisation={"start_known": False, "x_m": 5.0, "y_m": 2.5})
    assert "where it starts" in late.board.lost
    one.run(1.0)
    assert ghosts_of(first, plan, body=one.truth("r2").pose) == []
    stroll(one, late, (5.2, 4.2), (4.6, 3.0), (4.4, 3.6), robot="r2")
    assert late.board.lost == ""
    assert late.board.shared(OwnMap).local_pose.trajectory == 1, "its map begins where it was found"
    assert late.board.pose.distance_m(one.truth("r2").pose) < 0.15
    assert ghosts_of(late, plan, body=one.truth("r1").pose) == []
