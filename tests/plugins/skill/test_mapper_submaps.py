"""When a mapper takes a scan in, cuts submaps, tells of them, and moves them by what mates' scans say."""

import math
from itertools import pairwise

import numpy as np
import pytest

from robrain.algorithms.mapping.local_map import NO_DRIFT, NONE, LocalMap, LocalPose, OwnMap
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid, PatchCells
from robrain.algorithms.slam.map_patch import merge_message, pose_message, to_message
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper.own_submaps import OwnSubmaps, SubmapSpec
from robrain.protocol.messages.maps.map_messages import ROBOT_CLOSURES, ROBOT_MAP, Closure, Closures
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.ranges import STAMP_MAX

GRID = {"resolution_m": 0.1, "origin_x_m": -8.0, "origin_y_m": -8.0, "width_m": 16.0, "height_m": 16.0}
GEOMETRY = GridGeometry(0.1, -8.0, -8.0, 160, 160)
SQUARE_M = [min(2.0 / max(abs(math.cos(a)), abs(math.sin(a))), 5.0) for a in np.linspace(-np.pi, np.pi, 361)[:-1]]


def covariance(x_m, y_m=0.01, yaw_rad=0.01):
    return (x_m**2, 0.0, 0.0, 0.0, y_m**2, 0.0, 0.0, 0.0, yaw_rad**2)


def lies_at(place=IDENTITY, *, trajectory=0, until_ns=STAMP_MAX, fits=True, sigma_m=0.1):
    return LocalPose(place, trajectory, NO_DRIFT, until_ns, fits, sigma_m)


def mapping(stage, *, local_map=None, **settings):
    """A robot whose localisation says that it stands at the origin."""
    one = stage()
    host = one.host("mapper", mapper=GRID | settings, start=False)
    host.board.shared(OwnMap).local_map = local_map
    host.start()
    host.board.shared(OwnMap).local_pose = lies_at()
    host.board.pose_covariance = covariance(0.1)
    return one, host


def scanned(one, seconds=0.6):
    one.run(seconds, lambda: one.stand_and_scan(SQUARE_M))


def view(host):
    return host.manager.get("mapper").plugin.view()


def class_at(host, x_m, y_m):
    return view(host).classes[view(host).geometry.cell_of(x_m, y_m)]


def test_a_submap_begins_with_the_first_scan_and_another_after_five_metres(stage):
    one, host = mapping(stage)
    patches = one.inbox(ROBOT_MAP)
    scanned(one, 1.1)
    first = host.board.shared(OwnMap).local_map
    assert first.number == first.oldest == 20, "milliseconds of its first scan"
    assert first.variances == pytest.approx((0.01, 0.0001, 0.0001), rel=1e-3)
    for x_m in (1.5, 0.0, 1.5, 0.0):
        host.board.shared(OwnMap).local_pose = lies_at(Pose2D(x_m, 0.0, 0.0))
        scanned(one, 0.5)
    second = host.board.shared(OwnMap).local_map
    assert second.number > first.number
    assert second.oldest == first.number
    scanned(one)
    told = [received.message for received in patches.drain()]
    (finished,) = [patch for patch in told if patch.surfaces]
    assert 0.0 < finished.variance_m2 < 0.1
    assert 0.0 < finished.variance_rad2 < 0.1
    assert finished.submap == first.number
    assert {patch.submap for patch in told} == {first.number, second.number}
    assert [patch.submap for patch in told] == sorted(patch.submap for patch in told)
    assert one.call("mapper", "counters")["submaps"] == 2


@pytest.mark.slow
def test_old_submaps_that_the_map_no_longer_shows_go_and_those_that_it_shows_stay(stage):
    one, host = mapping(stage, graph={"submaps_max": 2})
    patches, team = one.inbox(ROBOT_MAP), SubmapAtlas(GEOMETRY)
    seen_once_m = 5.2
    for way in range(40):
        host.board.shared(OwnMap).local_pose = lies_at(Pose2D(seen_once_m if way == 1 else 1.5 * (way % 2), 0.0, 0.0))
        scanned(one, 0.5)
        for received in patches.drain():
            merge_message(team, received.message)
    scanned(one)
    for received in patches.drain():
        merge_message(team, received.message)
    # Of twelve submaps: two that can be moved, the last fixed one, and the one that saw the far place.
    assert one.call("mapper", "counters")["submaps"] == len(team.submaps) == 4
    assert class_at(host, seen_once_m + 2.05, 0.0) == OCCUPIED
    assert (view(host).classes == team.grid.classes()).all()


def test_a_robot_that_was_found_again_begins_its_map_anew(stage):
    one, host = mapping(stage)
    scanned(one)
    before = host.board.shared(OwnMap).local_map
    host.board.shared(OwnMap).local_pose = lies_at(Pose2D(3.0, 0.0, 0.0), trajectory=1)
    scanned(one)
    after = host.board.shared(OwnMap).local_map
    assert (after.trajectory, after.number, after.oldest) == (1, after.oldest, after.number)
    assert after.number > before.number
    assert after.anchor.x_m == 3.0
    assert class_at(host, -2.02, 0.0) == class_at(host, 5.02, 0.0) == OCCUPIED
    assert after.grid.classes()[after.grid.geometry.cell_of(-2.02, 0.0)] == UNKNOWN, "it goes by what it saw since"


QUARTER = Pose2D(1.0, 0.5, math.pi / 2)


def in_frame(T_arena_local):
    return LocalMap(OccupancyGrid(GEOMETRY), T_arena_local, IDENTITY, NONE, NO_DRIFT, 1, 1, 0)


@pytest.mark.parametrize("T_arena_local", [IDENTITY, QUARTER, Pose2D(-0.5, 1.0, -0.7)])
def test_mates_are_left_out_of_the_map_wherever_its_frame_lies(stage, T_arena_local):
    one, host = mapping(stage, local_map=in_frame(T_arena_local))
    one.wire.token(ROBOT_ALIVE, robot="r2")
    mate, wall = T_arena_local.compose(Pose2D(-3.0, 0.1, 0.0)), T_arena_local.compose(Pose2D(3.02, 0.05, 0.0))

    def each():
        one.say_state("r2", mate)
        one.stand_and_scan([2.85, 2.9, 3.0, 2.9])  # behind, right, ahead, left

    one.run(1.0, each)
    place = T_arena_local.compose(Pose2D(-2.87, 0.0, 0.0))
    assert class_at(host, place.x_m, place.y_m) != OCCUPIED
    assert class_at(host, wall.x_m, wall.y_m) == OCCUPIED


def mates_submap(one):
    """A submap of r2 at the team's place, and r2 itself."""
    one.wire.token(ROBOT_ALIVE, robot="r2")
    other = OccupancyGrid(GEOMETRY)
    other.merge_patch(0, 0, np.full((4, 4), FREE, np.int8), 10)
    one.publisher(ROBOT_MAP, robot="r2").put(
        to_message("r2", GEOMETRY, PatchCells(0, 0, other.classes(), int(other.stamp_ms.max())), submap=7)
    )
    scanned(one)


def closure(number, off_m):
    return Closures(
        robot="r2",
        closures=[
            Closure(
                submap=7,
                at=Pose2D(off_m, 0.0, 0.0),
                other_robot="r1",
                other_submap=number,
                at_other=IDENTITY,
                information=(1e6, 0.0, 0.0, 1e6, 0.0, 1e6),
            )
        ],
    )


def test_a_mates_scan_on_an_own_submap_moves_it_and_the_team_is_told(stage):
    one, host = mapping(stage)
    scanned(one, 1.2)
    mates_submap(one)
    patches = one.inbox(ROBOT_MAP, robot="r1")
    one.publisher(ROBOT_CLOSURES, robot="r2").put(closure(host.board.shared(OwnMap).local_map.number, 0.3))
    scanned(one, 1.2)
    moved = host.board.shared(OwnMap).local_map.T_arena_local
    assert moved.x_m == pytest.approx(0.3 * 0.01 / (0.01 + 4e-4), rel=0.02)
    assert host.board.shared(OwnMap).local_map.variances[0] == pytest.approx(1 / (1 / 0.01 + 1 / 4e-4), rel=0.05)
    assert class_at(host, 2.35, 0.0) == OCCUPIED
    assert class_at(host, -2.05, 0.0) == UNKNOWN, "the wall is where it is now, and not where it was"
    (part,) = [part for received in patches.drain() for part in received.message.parts]
    assert (part.robot, part.submap, part.T_arena_local) == ("r1", host.board.shared(OwnMap).local_map.number, moved)
    assert part.variance_m2 == pytest.approx(max(host.board.shared(OwnMap).local_map.variances[:2]))
    assert part.variance_rad2 == pytest.approx(host.board.shared(OwnMap).local_map.variances[2])


def test_submaps_are_moved_every_two_seconds_while_closures_come(stage):
    one, host = mapping(stage)
    scanned(one, 1.2)
    mates_submap(one)
    publisher, places = one.publisher(ROBOT_CLOSURES, robot="r2"), []
    for step in range(60):
        publisher.put(closure(host.board.shared(OwnMap).local_map.number, 0.3 + 0.001 * step))
        scanned(one, 0.1)
        places.append(host.board.shared(OwnMap).local_map.T_arena_local)
    moved = [step for step, (before, now) in enumerate(pairwise(places)) if now != before]
    assert [after - before for before, after in pairwise(moved)] == [20, 20]


def test_closures_of_a_robot_that_is_not_there_are_refused(stage):
    one, host = mapping(stage)
    scanned(one, 1.2)
    one.publisher(ROBOT_CLOSURES, robot="r3").put(closure(host.board.shared(OwnMap).local_map.number, 0.3))
    scanned(one, 1.0)
    assert host.board.shared(OwnMap).local_map.T_arena_local == IDENTITY


def test_what_was_mapped_from_a_false_start_is_withdrawn_and_the_team_is_told(stage):
    one, host = mapping(stage)
    patches = one.inbox(ROBOT_MAP)
    scanned(one, 1.2)
    wrong = host.board.shared(OwnMap).local_map.number
    team = SubmapAtlas(view(host).geometry)
    for received in patches.drain():
        merge_message(team, received.message)
    assert team.grid.known_count > 1000
    host.board.shared(OwnMap).false_start = True
    one.run(0.4, lambda: one.stand_and_scan([0.0] * 4))
    assert not np.any(view(host).classes == OCCUPIED)
    for received in patches.drain():
        merge_message(team, received.message)
    assert ("r1", wrong) not in team.submaps
    host.board.shared(OwnMap).local_pose = lies_at(Pose2D(1.0, 0.0, 0.0), trajectory=1)
    scanned(one, 1.2)
    assert host.board.shared(OwnMap).local_map.number > wrong
    assert class_at(host, 3.05, 0.0) == OCCUPIED, "from now on it maps again, though the start was false"
    assert class_at(host, -2.05, 0.0) == UNKNOWN


ANGLES_RAD = np.linspace(-np.pi, np.pi, 361)[:-1]
NOBODY = np.empty((0, 3))
RANGE_M = 6.0


def square_from(x_m, y_m=0.0):
    """What a lidar measures in a room of 4 × 4 m about the origin."""
    cos, sin = np.cos(ANGLES_RAD), np.sin(ANGLES_RAD)
    along_m = np.where(cos > 0, 2.0 - x_m, 2.0 + x_m) / np.maximum(abs(cos), 1e-9)
    across_m = np.where(sin > 0, 2.0 - y_m, 2.0 + y_m) / np.maximum(abs(sin), 1e-9)
    return np.minimum(along_m, across_m)


def mates_room():
    """The room, as a mate has mapped it and tells it: cells and surfaces of its submap 7."""
    own = OwnSubmaps(GEOMETRY, SubmapGraph("r2", GraphSpec()), SubmapSpec())
    own.begin_submap(7, IDENTITY, NO_DRIFT, np.eye(3))
    for x_m, y_m in ((0.0, 0.0), (1.0, 0.5), (-1.0, -0.5), (0.5, -1.0)):
        place = Pose2D(x_m, y_m, 0.0)
        own.integrate(place, ANGLES_RAD, square_from(x_m, y_m), RANGE_M, 10, NOBODY, NO_DRIFT)
    patch = own.pop_patch()
    return patch.cells, own.surfaces()


CELLS, SURFACES = mates_room()


def _parts(patch):
    return patch.parts or (patch,)


def publish_maps(one, submaps):
    for name in {name for name, _ in submaps}:
        one.wire.token(ROBOT_ALIVE, robot=name)
    one.run(0.6)
    for name, number in submaps:
        publisher = one.publisher(ROBOT_MAP, robot=name)
        publisher.put(to_message(name, GEOMETRY, CELLS, number))
        publisher.put(pose_message(name, GEOMETRY, number, IDENTITY, surfaces=SURFACES))
    one.run(0.6)


def test_a_scan_that_matches_a_teammates_map_gives_a_published_closure(stage):
    one, _ = mapping(stage)
    published = one.inbox(ROBOT_CLOSURES, robot="r1")
    publish_maps(one, [("r2", 7)])
    scanned(one, 1.6)
    (closure,) = [closure for received in published.drain() for closure in received.message.closures]
    assert (closure.other_robot, closure.other_submap) == ("r2", 7)


@pytest.mark.parametrize(
    ("mates", "leaves"), [((("r2", 7), ("r2", 8), ("r3", 7)), True), ((("r2", 7), ("r2", 8)), False)]
)
def test_a_robot_that_sees_something_else_than_two_mates_have_mapped_leaves_the_teams_map(stage, mates, leaves):
    """It stands in a room of 2 × 2 m where theirs is 4 × 4 m."""
    one = stage()
    host = one.host("mapper", mapper=GRID)
    host.board.pose_covariance = tuple(np.diag((0.001, 0.001, 0.0001)).ravel().tolist())
    told = one.inbox(ROBOT_MAP, robot="r1")
    publish_maps(one, mates)
    for turn in range(8):
        x_m = (-0.4, 0.4)[turn % 2]
        host.board.shared(OwnMap).local_pose = LocalPose(Pose2D(x_m, 0.0, 0.0), 0, NO_DRIFT, STAMP_MAX, True, 0.03)
        ranges_m = 0.5 * square_from(2.0 * x_m)
        one.run(1.2, lambda ranges_m=ranges_m: one.stand_and_scan(ranges_m.tolist()))
    assert one.call("mapper", "counters")["contradictions"] >= 6
    assert bool(host.board.shared(OwnMap).misplaced) == leaves
    withdrawn = {part.submap for each in told.drain() for part in _parts(each.message) if part.withdrawn}
    assert bool(withdrawn) == leaves
    if not leaves:
        return
    assert "contradict what the lidar sees" in host.board.shared(OwnMap).misplaced
    mapper = host.manager.get("mapper").live_plugin()
    assert not mapper._graph.own, "with all that it has mapped"
    left_out = one.call("mapper", "counters")["scans_skipped"]
    one.run(1.0, lambda: one.stand_and_scan(square_from(0.0).tolist()))
    assert one.call("mapper", "counters")["scans_skipped"] > left_out, "until localisation starts again"
    assert not mapper._graph.own
