"""When scans contradict the maps of so many mates that it is the robot that must be wrong."""

import numpy as np
import pytest

from robrain.algorithms.slam.submap import Submap
from robrain.algorithms.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper.closures import ClosureFinder
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from tests.algorithms.mapping.lidar_floor import GEOMETRY, ROOM, ROOM_PLACES

SEEN = ROOM.submap(*ROOM_PLACES)
PLACES = [Pose2D(1.6 + 0.75 * n, 4.6, 0.8) for n in range(8)] + [Pose2D(6.9, 3.8 - 0.75 * n, 0.8) for n in range(4)]
"""A way that leads on and on, so that each submap is tried in turn."""
ELSEWHERE = Pose2D(6.8, 1.0, 2.2)
SURE = (1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-5)
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
