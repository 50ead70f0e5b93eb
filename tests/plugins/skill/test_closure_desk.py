import math

import numpy as np
import pytest

from robrain.algorithms.mapping.local_map import NONE
from robrain.algorithms.numeric.small_linear_algebra import symmetric
from robrain.algorithms.slam.map_patch import joined_message, pose_message
from robrain.algorithms.slam.submap import Submap
from robrain.algorithms.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph, is_information
from robrain.plugins.skill.mapper import closures
from robrain.plugins.skill.mapper.closures import PATH_M, UNSAID, ClosureFinder
from robrain.protocol.messages.maps.map_messages import Closure, Closures, MapPatch
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, GridGeometry
from tests.algorithms.mapping.lidar_floor import GEOMETRY, ROOM, ROOM_PLACES

MATE = ("r2", 7)
TRUE = Pose2D(2.3, 4.1, 0.8)
SURE = (1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-5)
PRIOR = np.diag((0.04, 0.04, 0.01))
EVEN = (1e3, 0.0, 0.0, 1e3, 0.0, 1e4)
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

    def look(
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
    assert scene.look(TRUE, local)
    assert (scene.desk.closed, scene.desk.contradicted) == (1, 0)
    assert off(scene.solved().compose(local), TRUE) == pytest.approx((0.0, 0.0, 0.0), abs=0.015)


def test_a_closure_with_a_mate_is_told_to_it_in_both_frames() -> None:
    T_arena_local = Pose2D(1.0, -0.5, 0.3)
    scene = Scene(MATE, T_arena_local=T_arena_local)
    local = Pose2D(0.3, 0.2, -1.0)
    assert scene.look(TRUE, local, T_arena_local.compose(beside(TRUE, 0.03, -0.02, 0.01)))
    (closure,) = scene.desk.found
    assert (closure.submap, closure.other_robot, closure.other_submap) == (3, *MATE)
    assert off(closure.at_other, Pose2D(TRUE.x_m, TRUE.y_m, 0.0)) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert closure.at_other.yaw_rad == 0.0, "its axes are those of the mate's frame"
    assert (closure.at.x_m, closure.at.y_m) == (local.x_m, local.y_m)
    assert closure.at.yaw_rad == pytest.approx(local.yaw_rad - TRUE.yaw_rad, abs=0.01)
    information = symmetric(closure.information)
    assert is_information(information)
    assert np.linalg.eigvalsh(information).min() > 100.0


def test_a_closure_with_an_old_submap_of_its_own_is_told_to_nobody() -> None:
    scene = Scene(("r1", 1))
    for number in (4, 5):
        scene.graph.begin(number, IDENTITY, IDENTITY, 0, PRIOR)
    assert scene.look(TRUE, beside(TRUE, 0.05, 0.0))
    assert scene.desk.closed == 1
    assert scene.desk.found == []
    assert scene.solved().x_m == pytest.approx(-0.05, abs=0.015)


def test_without_a_submap_that_shows_the_place_there_is_nothing_to_look_at() -> None:
    assert Scene().look(TRUE, TRUE) is False
    scene = Scene(MATE)
    assert not scene.look(TRUE, Pose2D(30.0, 30.0, 0.0))
    assert scene.look(TRUE, TRUE), "the place where there was nothing does not count as tried"


def test_the_robot_moves_on_between_two_closures() -> None:
    scene = Scene(MATE, ("r3", 1), ("r4", 1))
    assert scene.look(TRUE, TRUE)
    near, far = beside(TRUE, PATH_M - 0.01, 0.0), beside(TRUE, PATH_M + 0.01, 0.0)
    assert scene.look(near, near) is False
    assert scene.desk.closed == 1
    assert scene.look(far, far)
    assert scene.desk.closed == 2
    assert not scene.look(near, near), "the way counts from the last one"


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
    assert scene.look(scanned, TRUE)
    assert (scene.desk.closed, scene.desk.contradicted) == (0, contradicted)
    assert scene.desk.found == []
    assert not scene.graph.has_news


FAR_X, FAR_Y, TURNED = beside(TRUE, 0.9, 0.0), beside(TRUE, 0.0, -0.7), beside(TRUE, 0.0, 0.0, 0.4)


@pytest.mark.parametrize(
    ("believed", "own", "mates"),
    [
        (FAR_X, (0.16, 1e-4, 0.0001), NONE),
        (FAR_Y, (1e-4, 0.16, 0.0001), NONE),
        (TURNED, (1e-4, 1e-4, 0.04), NONE),
        (FAR_X, (1e-4, 1e-4, 0.0001), (0.16, 0.16, 1e-6)),
        (FAR_X, (0.05, 1e-4, 0.0001), (0.05, 0.05, 1e-6)),
        (FAR_Y, (1e-4, 0.03, 0.0001), (0.03, 0.03, 1e-6)),
        (TURNED, (1e-4, 1e-4, 0.0001), (1e-4, 1e-4, 0.04)),
    ],
)
def test_the_less_sure_robot_and_mate_are_the_farther_the_scan_is_looked_for(
    believed: Pose2D, own: tuple[float, float, float], mates: tuple[float, float, float]
) -> None:
    x, y, yaw = own
    scene = Scene(MATE)
    scene.desk.receive_submap_poses(pose_message("r2", GEOMETRY, 7, IDENTITY, variances=(mates[0], mates[2])))
    assert scene.look(TRUE, believed, covariance=(x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, yaw))
    assert scene.desk.closed == 1
    (closure,) = scene.desk.found
    assert off(closure.at_other, Pose2D(TRUE.x_m, TRUE.y_m, 0.0)) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    sure = Scene(MATE)
    assert sure.look(TRUE, believed)
    assert sure.desk.closed == 0, "a robot that is sure of its place does not look for it"


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
    assert scene.look(TRUE, believed)
    (closure,) = scene.desk.found
    lies = Pose2D(closure.at_other.x_m, closure.at_other.y_m, believed.yaw_rad - closure.at.yaw_rad)
    assert off(lies, TRUE) == pytest.approx(left, abs=0.012)


def closure_on(mate: str, number: int = 3, information: tuple[float, ...] = EVEN) -> Closures:
    closure = Closure(
        submap=7,
        at=IDENTITY,
        other_robot=mate,
        other_submap=number,
        at_other=Pose2D(0.1, 0.0, 0.0),
        information=information,
    )
    return Closures(robot="r2", closures=[closure])


def test_a_mates_scan_on_its_own_submap_moves_it() -> None:
    scene = Scene(MATE)
    scene.desk.receive(closure_on("r1"))
    assert scene.graph.rests_on("r2")
    assert scene.solved().x_m == pytest.approx(-0.1, abs=0.01)


def told(number: int, *, robot: str = "r2", variances: tuple[float, float] = (0.04, 0.01), **how: bool) -> MapPatch:
    return pose_message(robot, GEOMETRY, number, IDENTITY, variances=variances, **how)


def test_a_mate_tells_how_sure_it_is_of_where_its_submaps_lie() -> None:
    desk = Scene().desk
    assert desk.variances_of(MATE) == UNSAID
    desk.receive_submap_poses(told(7))
    assert desk.variances_of(MATE) == (0.04, 0.04, 0.01)
    assert desk.variances_of(("r2", 8)) == UNSAID
    desk.receive_submap_poses(joined_message("r2", GEOMETRY, [told(7, variances=(0.09, 0.02)), told(8)]))
    assert desk.variances_of(MATE) == (0.09, 0.09, 0.02)
    assert desk.variances_of(("r2", 8)) == (0.04, 0.04, 0.01)
    desk.receive_submap_poses(told(7, variances=(0.0, 0.0)))
    assert desk.variances_of(MATE) == (0.09, 0.09, 0.02), "a message of cells alone says nothing of it"


def test_what_a_mate_says_of_others_submaps_and_of_withdrawn_ones_is_left_out() -> None:
    desk = Scene().desk
    parts = [told(5, robot="r3"), told(6, withdrawn=True), told(7)]
    desk.receive_submap_poses(joined_message("r2", GEOMETRY, parts))
    assert desk.variances_of(("r3", 5)) == desk.variances_of(("r2", 6)) == UNSAID
    assert desk.variances_of(MATE) == (0.04, 0.04, 0.01)


@pytest.mark.parametrize(
    ("robot", "cells", "is_news"), [("r2", b"", True), ("r2", b"cells", False), ("r3", b"", False)]
)
def test_a_mates_submap_that_was_moved_is_news_if_the_robot_goes_by_it(robot: str, cells: bytes, is_news: bool) -> None:
    scene = Scene(MATE)
    scene.desk.receive(closure_on("r1"))
    scene.solved()
    assert not scene.graph.has_news
    patch = told(7, robot=robot)
    parts = [patch if not cells else MapPatch(**{**patch_fields(patch), "cells": cells})]
    scene.desk.receive_submap_poses(joined_message(robot, GEOMETRY, parts))
    assert scene.graph.has_news == is_news


def patch_fields(patch: MapPatch) -> dict[str, object]:
    return {name: getattr(patch, name) for name in patch.__struct_fields__}


def test_where_own_submaps_lie_is_as_sure_as_the_graph_says() -> None:
    scene = Scene(("r1", 1))
    assert scene.desk.variances_of(("r1", 3)) == (0.04, 0.04, 0.01)
    assert scene.desk.variances_of(("r1", 1)) == UNSAID, "one that cannot be moved any more"
    scene.desk.receive_submap_poses(told(3))
    assert scene.desk.variances_of(("r2", 3)) == (0.04, 0.04, 0.01)


PLACES = [Pose2D(1.6 + 0.75 * n, 4.6, 0.8) for n in range(8)] + [Pose2D(6.9, 3.8 - 0.75 * n, 0.8) for n in range(4)]
"""A way that leads on and on, so that each submap is tried in turn."""
ELSEWHERE = Pose2D(6.8, 1.0, 2.2)
TWO_ROBOTS: tuple[SubmapKey, ...] = (("r2", 7), ("r2", 8), ("r3", 1))


def desk_with(keys: tuple[SubmapKey, ...]) -> ClosureFinder:
    """A robot's desk that knows these submaps, all of the same room."""
    graph, atlas = SubmapGraph("r1", GraphSpec()), SubmapAtlas(GEOMETRY)
    for key in keys:
        submap = Submap(IDENTITY)
        submap.merge(SEEN.row, SEEN.column, SEEN.classes(), 1)
        submap.surfaces = SEEN.surfaces
        atlas.submaps[key] = submap
    graph.begin(3, IDENTITY, IDENTITY, 0, np.diag((0.04, 0.04, 0.01)))
    return ClosureFinder("r1", graph, atlas, 0.0)


def look(desk: ClosureFinder, turn: int, *, wrong: bool = True) -> None:
    """Lay a scan on the next submap: one of elsewhere, or one of the place where the robot believes to be."""
    here = PLACES[turn % len(PLACES)]
    points = ROOM.points(ELSEWHERE if wrong else here)
    assert desk.check(3, here, here, lambda: points, SURE)


def test_six_scans_that_contradict_three_submaps_of_two_robots_say_that_the_robot_is_wrong() -> None:
    desk = desk_with(TWO_ROBOTS)
    whys = []
    for turn in range(6):
        look(desk, turn)
        whys.append(desk.misplacement_reason())
    assert desk.contradicted == 6
    assert whys[:5] == [""] * 5
    assert whys[5] == "3 submaps of 2 robots contradict what the lidar sees"
    assert desk.misplacement_reason() == "", "it is said once, and the count starts again"
    look(desk, 6)
    assert desk.misplacement_reason() == ""


@pytest.mark.parametrize("keys", [TWO_ROBOTS[1:], (("r2", 7), ("r2", 8), ("r2", 9))])
def test_two_submaps_or_one_robot_alone_may_be_wrong_themselves(keys: tuple[SubmapKey, ...]) -> None:
    desk = desk_with(keys)
    for turn in range(12):
        look(desk, turn)
        assert desk.misplacement_reason() == ""
    assert desk.contradicted == 12


def test_scans_that_agree_with_mates_are_weighed_against_those_that_contradict() -> None:
    desk = desk_with(TWO_ROBOTS)
    for turn in range(8):
        look(desk, turn, wrong=turn % 2 == 1)
        assert desk.misplacement_reason() == ""
    look(desk, 8)
    assert desk.misplacement_reason() == "", "5 of the last 9"
    look(desk, 9)
    assert desk.misplacement_reason(), "6 of the last 9"


def test_that_its_own_submaps_agree_says_nothing_for_the_place_of_a_robot() -> None:
    own = ("r1", 1)
    desk = desk_with((*TWO_ROBOTS, own))
    for turn in range(12):
        key = TWO_ROBOTS[turn // 2 % 3] if turn % 2 else own
        desk.candidate = lambda _sensor, key=key: key
        assert desk.misplacement_reason() == ""
        look(desk, turn, wrong=key != own)
    assert (desk.closed, desk.contradicted) == (6, 6)
    assert desk.misplacement_reason()


def test_contradictions_of_before_the_robot_began_anew_do_not_count() -> None:
    desk = desk_with(TWO_ROBOTS)
    for turn in range(5):
        look(desk, turn)
    desk.restart()
    look(desk, 5)
    assert desk.misplacement_reason() == ""


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


@pytest.mark.parametrize("fields", [{"other_robot": "r3"}, {"other_submap": 6}])
def test_a_closure_with_a_submap_that_the_robot_does_not_have_says_nothing(desk, graph, fields):
    assert desk.receive(reported(**fields)) == ""
    assert not graph.has_news


def test_submaps_that_do_not_exist_displace_no_variances_of_others(desk, atlas, monkeypatch):
    monkeypatch.setattr(closures, "OTHER_SUBMAPS_MAX", 4)
    atlas.merge(("r3", 1), 0, 0, np.array([[FREE]]), 5)
    for robot, numbers in (("r2", range(4)), ("r3", (1,)), ("r2", range(10, 20))):
        parts = [pose_message(robot, LARGE, number, IDENTITY, variances=(0.5, 0.1)) for number in numbers]
        desk.receive_submap_poses(joined_message(robot, LARGE, parts))
    assert desk.variances_of(("r3", 1)) == (0.5, 0.5, 0.1)
    assert len(desk._variances) <= 4


@pytest.mark.parametrize("variances", [(0.0, 0.0), (-1e15, -1e15)])
def test_no_mate_is_surer_of_its_place_than_a_scan_can_make_it(desk, variances):
    desk.receive_submap_poses(pose_message("r2", LARGE, 7, IDENTITY, variances=variances))
    assert desk.variances_of(("r2", 7)) == UNSAID
