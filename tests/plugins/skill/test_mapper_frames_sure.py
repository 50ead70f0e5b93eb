"""How sure a robot has to be of where its map lies before it moves into another frame: a wrong place is worse.

Each search is made with a mate's map that lies a little differently, as it would be found wrongly.
"""

import math

import numpy as np
import pytest

from robrain.plugins.skill.mapper import frames as module
from robrain.plugins.skill.mapper.frames import ANSWERS_MAX
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.map_frame import ARENA
from tests.plugins.unit.frame_scene import MATES, PLACES, T_OWN_FLOOR, lost

MIDDLE = PLACES[1]


def turned_about(place: Pose2D, turn_rad: float) -> Pose2D:
    """A frame that is turned about a place, which stays where it is."""
    return place.compose(Pose2D(0.0, 0.0, turn_rad)).compose(place.inverse())


@pytest.mark.parametrize(("step_rad", "is_sure"), [(0.0, True), (0.02, True), (0.035, False)])
def test_answers_that_put_the_robot_in_one_place_but_turn_it_differently_do_not_agree(
    step_rad: float, is_sure: bool
) -> None:
    scene = lost()
    moved = []
    for turn in (-1, 0, 1):
        scene.mates_map(ARENA, turned_about(MIDDLE, turn * step_rad))
        moved.append(scene.search(MIDDLE))
    assert moved == [False, False, is_sure]


@pytest.mark.parametrize(("step_m", "is_sure"), [(0.07, True), (0.11, True), (0.18, False)])
def test_answers_that_put_the_robot_beside_each_other_by_more_than_three_decimetres_do_not_agree(
    step_m: float, is_sure: bool
) -> None:
    scene = lost()
    moved = []
    for n in (0, 1, 2):
        scene.mates_map(ARENA, Pose2D(0.0, n * step_m, 0.0))
        moved.append(scene.search(MIDDLE))
    assert moved == [False, False, is_sure]


def test_answers_of_one_frame_say_nothing_of_another() -> None:
    scene = lost()
    scene.mates_map(MATES, number=9)
    assert [scene.search(MIDDLE) for _ in range(5)] == [False] * 4 + [True], "both are searched in turn"


def test_old_answers_are_forgotten_when_many_newer_ones_say_otherwise() -> None:
    scene = lost()
    for _ in range(2):
        assert not scene.search(MIDDLE)
    for n in range(1, ANSWERS_MAX + 1):
        scene.mates_map(ARENA, Pose2D(0.4 * n, 0.0, 0.0))
        assert not scene.search(MIDDLE)
    scene.mates_map(ARENA, IDENTITY)
    assert not scene.search(MIDDLE)


def test_places_of_mates_count_as_places_from_which_answers_were_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot itself stands all the time, where nothing is to be seen."""
    monkeypatch.setattr(module, "PLAIN_MIN", 1_000_000)
    nowhere = T_OWN_FLOOR.inverse().compose(Pose2D(11.0, 11.0, 0.0))
    for places, is_sure in (((PLACES[1], PLACES[1]), False), ((PLACES[1], PLACES[3]), True)):
        scene = lost()
        moved = []
        for n in range(12):
            at = places[n // 3 % 2]
            scene.mates = {ARENA: [(at.x_m, at.y_m, 0.2)]}
            moved.append(scene.search(nowhere))
        assert any(moved) == is_sure


def test_a_robot_that_joins_is_surest_of_its_submaps_where_it_was_found() -> None:
    scene = lost()
    scene.map(21, Pose2D(7.0, 5.0, 0.0))
    before = {number: np.diag(node.covariance).copy() for number, node in scene.graph.own.items()}
    moved = [scene.search(place) for place in (PLACES[0], PLACES[0], PLACES[0])]
    assert moved == [False, False, True]
    grown = {number: np.diag(node.covariance) - before[number] for number, node in scene.graph.own.items()}
    near, far = grown[20], grown[21]
    assert math.sqrt(near[:2].sum()) == pytest.approx(0.1 * math.sqrt(2.0), abs=0.02)
    assert far[0] > 1.2 * near[0]
    assert (near[2], far[2]) == pytest.approx((0.02**2, 0.02**2))
