import math

import numpy as np
import pytest

from robrain.algorithms.slam.map_patch import joined_message, pose_message
from robrain.algorithms.slam.submap import Submap
from robrain.algorithms.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper import closures
from robrain.plugins.skill.mapper.closures import ClosureFinder
from robrain.protocol.messages.maps.map_messages import Closure, Closures
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, GridGeometry
from tests.algorithms.mapping.lidar_floor import GEOMETRY, ROOM, ROOM_PLACES

MATE = ("r2", 7)
TRUE = Pose2D(2.3, 4.1, 0.8)
SURE = (1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-5)
PRIOR = np.diag((0.04, 0.04, 0.01))
SEEN = ROOM.submap(*ROOM_PLACES)


def beside(pose: Pose2D, x_m: float, y_m: float, turn_rad: float = 0.0) -> Pose2D:
    return Pose2D(pose.x_m + x_m, pose.y_m + y_m, pose.yaw_rad + turn_rad)


def off(pose: Pose2D, other: Pose2D) -> tuple[float, float, float]:
    turned_rad = math.remainder(pose.yaw_rad - other.yaw_rad, math.tau)
    return pose.x_m - other.x_m, pose.y_m - other.y_m, turned_rad


class Scene:
    """A robot r1 in ROOM with its current submap 3; others' submaps show the room."""

    def __init__(self, *keys: SubmapKey, T_arena_local: Pose2D = IDENTITY, slack_m: float = 0.0) -> None:
        self.graph = SubmapGraph("r1", GraphSpec())
        self.atlas = SubmapAtlas(GEOMETRY)
        self.desk = ClosureFinder("r1", self.graph, self.atlas, slack_m)
        for key in keys:
            submap = Submap(T_arena_local)
            submap.merge(SEEN.row, SEEN.column, SEEN.classes(), 1)
            submap.surfaces = SEEN.surfaces
            self.atlas.submaps[key] = submap
        self.graph.begin(3, IDENTITY, IDENTITY, 0, PRIOR)

    def scan_and_search(
        self, true: Pose2D, local: Pose2D, sensor: Pose2D | None = None, covariance: tuple[float, ...] = SURE
    ) -> bool:
        return self.desk.check(3, local, sensor or local, lambda: ROOM.points(true), covariance)

    def solved(self) -> Pose2D:
        """T_arena_local of the robot's submap, once the graph is solved."""
        self.graph.solve(self.atlas.place_of, self.desk.variances_of)
        return self.graph.own[3].T_arena_local


@pytest.mark.parametrize("wrong", [(0.06, -0.04, 0.02), (-0.05, 0.08, -0.03)])
def test_a_scan_that_lies_on_a_mates_submap_puts_the_robots_submap_right(wrong: tuple[float, float, float]) -> None:
    scene = Scene(MATE)
    local = beside(TRUE, *wrong)
    assert scene.scan_and_search(TRUE, local)
    assert (scene.desk.closed, scene.desk.contradicted) == (1, 0)
    assert off(scene.solved().compose(local), TRUE) == pytest.approx((0.0, 0.0, 0.0), abs=0.015)


@pytest.mark.parametrize("axis", [0, 4])
def test_a_scan_is_searched_for_as_far_as_robot_and_submap_are_unsure_together(axis: int) -> None:
    scene = Scene(MATE)
    scene.desk.receive_submap_poses(
        joined_message("r2", GEOMETRY, [pose_message("r2", GEOMETRY, 7, IDENTITY, variances=(0.03, 1e-5))])
    )
    unsure = tuple(0.03 if index == axis else value for index, value in enumerate(SURE))
    assert scene.scan_and_search(TRUE, beside(TRUE, 0.4, 0.4), covariance=unsure)
    assert scene.desk.closed == 1


@pytest.mark.parametrize(
    ("scanned", "contradicted"),
    [
        (Pose2D(6.8, 1.0, 2.2), 1),  # from elsewhere: a sixth of the beams agree
        (beside(TRUE, 0.0, 0.0, 0.3), 0),  # most of them agree: it may be the believed place that is wrong
    ],
)
def test_a_scan_that_lies_nowhere_on_a_submap_that_knows_the_place_contradicts_it(
    scanned: Pose2D, contradicted: int
) -> None:
    scene = Scene(MATE)
    assert scene.scan_and_search(scanned, TRUE)
    assert (scene.desk.closed, scene.desk.contradicted) == (0, contradicted)
    assert scene.desk.found == []
    assert not scene.graph.has_news


@pytest.mark.parametrize(
    ("slack_m", "left"),
    [
        (0.0, (0.0, 0.0, 0.0)),
        (0.05, (0.03, 0.04, 0.01)),  # 0.1 m off, half of which is slack; 0.02 rad, of which the slack is 0.01
        (0.2, (0.06, 0.08, 0.02)),
    ],
)
def test_offsets_within_the_slack_are_taken_for_none(slack_m: float, left: tuple[float, float, float]) -> None:
    scene = Scene(MATE, slack_m=slack_m)
    believed = beside(TRUE, 0.06, 0.08, 0.02)
    assert scene.scan_and_search(TRUE, believed)
    (closure,) = scene.desk.found
    lies = Pose2D(closure.at_other.x_m, closure.at_other.y_m, believed.yaw_rad - closure.at.yaw_rad)
    assert off(lies, TRUE) == pytest.approx(left, abs=0.012)


PLACES = [Pose2D(1.6 + 0.75 * n, 4.6, 0.8) for n in range(8)] + [Pose2D(6.9, 3.8 - 0.75 * n, 0.8) for n in range(4)]
"""A way that leads on and on, so that each submap is tried in turn."""
ELSEWHERE = Pose2D(6.8, 1.0, 2.2)
TWO_ROBOTS: tuple[SubmapKey, ...] = (("r2", 7), ("r2", 8), ("r3", 1))


def search_once(desk: ClosureFinder, turn: int, *, wrong: bool = True) -> None:
    """Lay a scan on the next submap: one of elsewhere, or one of the place where the robot believes to be."""
    here = PLACES[turn % len(PLACES)]
    points = ROOM.points(ELSEWHERE if wrong else here)
    assert desk.check(3, here, here, lambda: points, SURE)


def test_six_scans_that_contradict_three_submaps_of_two_robots_say_that_the_robot_is_wrong() -> None:
    desk = Scene(*TWO_ROBOTS).desk
    whys = []
    for turn in range(6):
        search_once(desk, turn)
        whys.append(desk.misplacement_reason())
    assert desk.contradicted == 6
    assert whys[:5] == [""] * 5
    assert whys[5] == "3 submaps of 2 robots contradict what the lidar sees"
    assert desk.misplacement_reason() == "", "it is said once, and the count starts again"
    search_once(desk, 6)
    assert desk.misplacement_reason() == ""


@pytest.mark.parametrize("keys", [TWO_ROBOTS[1:], (("r2", 7), ("r2", 8), ("r2", 9))])
def test_two_submaps_or_one_robot_alone_may_be_wrong_themselves(keys: tuple[SubmapKey, ...]) -> None:
    desk = Scene(*keys).desk
    for turn in range(12):
        search_once(desk, turn)
        assert desk.misplacement_reason() == ""
    assert desk.contradicted == 12


LARGE = GridGeometry(0.1, -8.0, -8.0, 160, 160)
PRECISE = (1e4, 0.0, 0.0, 1e4, 0.0, 1e4)
BESIDE = Pose2D(0.3, 0.0, 0.0)


@pytest.fixture
def atlas():
    return SubmapAtlas(LARGE)


@pytest.fixture
def graph():
    graph = SubmapGraph("r1", GraphSpec())
    graph.begin(5, IDENTITY, IDENTITY, 0, np.diag((0.01, 0.01, 0.001)))
    return graph


@pytest.fixture
def desk(graph, atlas):
    return ClosureFinder("r1", graph, atlas, 0.0)


def reported(**fields):
    closure = {
        "submap": 7,
        "at": IDENTITY,
        "other_robot": "r1",
        "other_submap": 5,
        "at_other": BESIDE,
        "information": PRECISE,
    }
    return Closures(robot="r2", closures=[Closure(**(closure | fields))])


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"information": (-1.0, 0.0, 0.0, 1.0, 0.0, 1.0)}, "no inverse covariance"),
        ({"information": (1.0, 5.0, 0.0, 1.0, 0.0, 1.0)}, "no inverse covariance"),  # an indefinite matrix
        ({"information": (0.0,) * 6}, "no inverse covariance"),
        ({"information": (1e15, 0.0, 0.0, 1e15, 0.0, 1e15)}, "no inverse covariance"),  # sure to 30 nm
        ({"at": Pose2D(1e6, 0.0, 0.0), "at_other": Pose2D(1e6, 0.0, 0.0)}, "far outside"),  # a lever of 1000 km
        ({"at_other": Pose2D(0.0, -250.0, 0.0)}, "far outside"),
    ],
)
def test_a_closure_that_no_scan_can_show_is_refused(desk, graph, fields, why):
    assert why in desk.receive(reported(**fields))
    assert not graph.has_news


def test_submaps_that_do_not_exist_displace_no_variances_of_others(desk, atlas, monkeypatch):
    monkeypatch.setattr(closures, "OTHER_SUBMAPS_MAX", 4)
    atlas.merge(("r3", 1), 0, 0, np.array([[FREE]]), 5)
    for robot, numbers in (("r2", range(4)), ("r3", (1,)), ("r2", range(10, 20))):
        parts = [pose_message(robot, LARGE, number, IDENTITY, variances=(0.5, 0.1)) for number in numbers]
        desk.receive_submap_poses(joined_message(robot, LARGE, parts))
    assert desk.variances_of(("r3", 1)) == (0.5, 0.5, 0.1)
    assert len(desk._variances) <= 4
