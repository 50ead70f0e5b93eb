import math

import numpy as np
import pytest

from robrain.algorithms.mapping.local_map import NONE
from robrain.algorithms.numeric.small_linear_algebra import symmetric
from robrain.algorithms.slam.map_patch import joined_message, pose_message
from robrain.algorithms.slam.submap import Submap
from robrain.algorithms.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph, is_information
from robrain.plugins.skill.mapper.closures import PATH_M, UNSAID, ClosureFinder
from robrain.protocol.messages.maps.map_messages import Closure, Closures, MapPatch
from robrain.protocol.model.geometry import IDENTITY, Pose2D
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
    ("robot", "cells", "is_news"),
    [("r2", b"", True), ("r2", b"cells", False), ("r3", b"", False)],
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
