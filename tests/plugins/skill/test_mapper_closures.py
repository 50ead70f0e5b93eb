"""When a mapper lays its scans on mates' submaps, what it tells of that, and when it begins to look anew."""

import math

import numpy as np
import pytest

from robrain.algorithms.mapping.local_map import NO_DRIFT, LocalPose, OwnMap
from robrain.algorithms.slam.map_patch import pose_message, to_message
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper.own_submaps import OwnSubmaps, SubmapSpec
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.ranges import STAMP_MAX
from robrain.protocol.table.topics import ROBOT_ALIVE, ROBOT_CLOSURES, ROBOT_MAP

GRID = {"resolution_m": 0.1, "origin_x_m": -8.0, "origin_y_m": -8.0, "width_m": 16.0, "height_m": 16.0}
GEOMETRY = GridGeometry(0.1, -8.0, -8.0, 160, 160)
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


class Scene:
    """A robot r1 that stands where it is put, and mates that have each mapped the room."""

    def __init__(self, stage, *mates, **mapper):
        self.one = stage()
        self.host = self.one.host("mapper", mapper=GRID | mapper)
        self.host.board.pose_covariance = tuple(np.diag((0.01, 0.01, 0.001)).ravel().tolist())
        self.told = self.one.inbox(ROBOT_CLOSURES, robot="r1")
        for mate in mates:
            self.one.wire.token(ROBOT_ALIVE, robot=mate)
        self.one.run(0.6)
        for mate in mates:
            say = self.one.publisher(ROBOT_MAP, robot=mate)
            say.put(to_message(mate, GEOMETRY, CELLS, 7))
            say.put(pose_message(mate, GEOMETRY, 7, IDENTITY, surfaces=SURFACES))
        self.one.run(0.6)

    def scan(self, x_m, seconds, *, y_m=0.0, **says):
        """Stand there for so long, where localisation says so."""
        fields = {"trajectory": 0, "lost": "", "checked": None, "fits": True} | says
        self.host.board.shared(OwnMap).local_pose = LocalPose(
            Pose2D(x_m, y_m, 0.0),
            fields["trajectory"],
            NO_DRIFT,
            STAMP_MAX,
            fields["fits"],
            0.1,
            fields["lost"],
            fields["checked"],
        )
        self.one.run(seconds, lambda: self.one.stand_and_scan(square_from(x_m, y_m).tolist()))

    def counters(self):
        return self.one.call("mapper", "counters")

    @property
    def closures(self):
        return self.counters()["closures"]


def test_a_closure_is_told_once_and_with_all_that_the_mate_needs(stage):
    scene = Scene(stage, "r2")
    scene.scan(0.0, 3.0)
    assert scene.closures == 1
    (message,) = [received.message for received in scene.told.drain()]
    (closure,) = message.closures
    assert (message.robot, closure.other_robot, closure.other_submap) == ("r1", "r2", 7)
    assert closure.submap == scene.host.board.shared(OwnMap).local_map.number


def test_a_robot_that_drives_fast_lays_one_scan_a_second_on_the_submaps_of_others(stage):
    scene = Scene(stage, *(f"r{number}" for number in range(2, 8)))
    for step in range(12):
        scene.scan((-1.0, -0.3, 0.4, 1.1)[step % 4], 0.24, y_m=0.2 * (step % 3))
    assert scene.closures == 3


def test_a_robot_that_comes_back_lays_its_scans_on_its_own_old_submaps(stage):
    scene = Scene(stage, submap={"way_m": 0.5})
    for x_m in (0.0, 0.6, 1.2, 0.6, 0.0):
        scene.scan(x_m, 0.4)
    counters = scene.counters()
    assert counters["submaps"] == 5
    assert counters["closures"] > 0
    assert scene.told.drain() == [], "which concerns nobody else"


def test_a_robot_that_maps_in_a_frame_of_its_own_goes_on_mapping_while_it_is_lost(stage):
    scene = Scene(stage)
    scene.host.board.lost = "it was carried"
    scene.scan(0.0, 0.5)
    assert scene.counters()["scans"] == 0
    assert "it was carried" in scene.counters()["why_left_out"]
    scene.scan(0.0, 0.5, trajectory=1, lost="it was carried")
    assert scene.counters()["scans"] > 10
    assert scene.host.board.frame != ARENA
    assert scene.host.board.shared(OwnMap).local_map.reason == "it was carried"


def test_scans_that_localisation_has_not_laid_on_the_map_are_passed_over(stage):
    scene = Scene(stage)
    scene.scan(0.0, 0.5, checked=())
    counters = scene.counters()
    assert (counters["scans"], counters["scans_left_out"]) == (0, 0)
    now_ns = scene.one.clock.now_ns()
    scene.scan(0.0, 0.5, checked=(now_ns + 40_000_000, now_ns + 100_000_000))
    assert scene.counters()["scans"] == 2


@pytest.mark.parametrize(("sigma_m", "is_mapped"), [(0.5, True), (0.501, False)])
def test_scans_are_mapped_up_to_the_limit_that_was_set(stage, sigma_m, is_mapped):
    one = stage()
    host = one.host("mapper", mapper=GRID | {"sigma_max_m": 0.5})
    host.board.shared(OwnMap).local_pose = LocalPose(IDENTITY, 0, NO_DRIFT, STAMP_MAX, True, sigma_m)
    host.board.pose_covariance = tuple(np.eye(3).ravel().tolist())
    one.run(0.2, lambda: one.stand_and_scan(square_from(0.0).tolist()))
    assert (one.call("mapper", "counters")["scans"] > 0) == is_mapped
    assert math.isclose(one.call("mapper", "known_area_m2"), 0.0) != is_mapped


def _parts(patch):
    return patch.parts or (patch,)


@pytest.mark.parametrize(
    ("mates", "leaves"), [((("r2", 7), ("r2", 8), ("r3", 7)), True), ((("r2", 7), ("r2", 8)), False)]
)
def test_a_robot_that_sees_something_else_than_two_mates_have_mapped_leaves_the_teams_map(stage, mates, leaves):
    """It stands in a room of 2 × 2 m where theirs is 4 × 4 m."""
    one = stage()
    host = one.host("mapper", mapper=GRID)
    host.board.pose_covariance = tuple(np.diag((0.001, 0.001, 0.0001)).ravel().tolist())
    told = one.inbox(ROBOT_MAP, robot="r1")
    for mate in {mate for mate, _ in mates}:
        one.wire.token(ROBOT_ALIVE, robot=mate)
    one.run(0.6)
    for mate, number in mates:
        say = one.publisher(ROBOT_MAP, robot=mate)
        say.put(to_message(mate, GEOMETRY, CELLS, number))
        say.put(pose_message(mate, GEOMETRY, number, IDENTITY, surfaces=SURFACES))
    one.run(0.6)
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
    left_out = one.call("mapper", "counters")["scans_left_out"]
    one.run(1.0, lambda: one.stand_and_scan(square_from(0.0).tolist()))
    assert one.call("mapper", "counters")["scans_left_out"] > left_out, "until localisation starts again"
    assert not mapper._graph.own
