"""Own submaps whose map frame changes: a whole frame joins another one, or a trajectory leaves its frame."""

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.slam.submap_graph import BEGINNING, GraphSpec, SubmapGraph
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.map_frame import ARENA, MapFrame
from tests.algorithms.slam.submap_walks import graph_of, no_doubt, nowhere, off

MATE, THIRD = ("r2", 7), ("r3", 1)
OWN = MapFrame(10, "r1")
STEP = np.diag((0.0025, 0.0016, 0.0001))
walked = partial(graph_of, BEGINNING, STEP, frame=OWN)
SURE = np.diag((1e4, 1e4, 1e6))
JOINED = np.diag((0.01, 0.01, 0.0004))
ROW = [Pose2D(0.0, 0.0, 0.0), Pose2D(4.0, 0.0, 0.5), Pose2D(8.0, 1.0, -0.4), Pose2D(12.0, 0.0, 0.0)]
POSES = st.builds(Pose2D, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-3.1, 3.1))


NOWHERE_OFF = pytest.approx((0.0, 0.0, 0.0), abs=1e-4)


@settings(deadline=None, max_examples=30)
@given(POSES, st.integers(0, 3))
def test_a_frame_that_joins_another_takes_all_its_submaps_along_and_they_stay_there(move, found_at):
    graph = walked(*ROW)
    graph.change_frame(OWN, ARENA, move, move.compose(ROW[found_at]), JOINED)
    for _ in range(2):
        for node, anchor in zip(graph.own.values(), ROW, strict=True):
            assert node.frame == ARENA
            assert off(node.pose, move.compose(anchor)) == NOWHERE_OFF
            assert off(node.T_arena_local, move) == NOWHERE_OFF
        assert graph.solve(nowhere, no_doubt) == {}


def test_a_frame_that_joins_another_is_surest_where_it_was_found():
    graph = walked(*ROW)
    move = Pose2D(3.0, -2.0, 1.0)
    graph.change_frame(OWN, ARENA, move, move.compose(ROW[2]), JOINED)
    assert graph.has_news
    graph.solve(nowhere, no_doubt)
    variances = [float(node.covariance[0, 0] + node.covariance[1, 1]) for node in graph.own.values()]
    assert variances.index(min(variances)) == 2
    assert min(variances) >= 0.02, "no surer than the answer"
    assert max(variances) < 1.0, "the steps between them hold the others"


@settings(deadline=None, max_examples=30)
@given(st.floats(-3.1, 3.1), st.integers(0, 1000))
def test_a_covariance_is_turned_as_any_matrix_is(yaw_rad, seed):
    root = np.random.default_rng(seed).normal(0.0, 0.3, (3, 3))
    graph = SubmapGraph("r1", GraphSpec())
    graph.begin(10, IDENTITY, IDENTITY, 0, root @ root.T, OWN)
    graph.change_frame(OWN, ARENA, Pose2D(0.0, 0.0, yaw_rad), IDENTITY, np.zeros((3, 3)))
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    assert graph.own[10].covariance == pytest.approx(turn @ root @ root.T @ turn.T, abs=1e-12)


@pytest.mark.parametrize("second", [Pose2D(0.3, -0.2, 0.05), Pose2D(5.0, 3.0, 2.0)])
def test_from_frame_to_frame_the_submaps_go_along_each_time(second):
    graph = walked(*ROW)
    first, mates = Pose2D(3.0, -2.0, 1.0), MapFrame(7, "r2")
    graph.change_frame(OWN, mates, first, first.compose(ROW[1]), JOINED)
    graph.solve(nowhere, no_doubt)
    both = second.compose(first)
    graph.change_frame(mates, ARENA, second, both.compose(ROW[3]), JOINED)
    graph.solve(nowhere, no_doubt)
    for node, anchor in zip(graph.own.values(), ROW, strict=True):
        assert off(node.pose, both.compose(anchor)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)


def test_after_joining_a_mate_moves_all_of_the_robots_submaps_by_a_closure_with_one():
    """Where the frame began was known by definition; in the new frame it is not."""
    graph = walked(*ROW)
    graph.change_frame(OWN, ARENA, IDENTITY, ROW[1], JOINED)
    off_m = 0.15
    graph.close(12, ROW[2], MATE, Pose2D(ROW[2].x_m, ROW[2].y_m + off_m, ROW[2].yaw_rad), SURE)
    graph.solve(lambda _key, frame: IDENTITY if frame == ARENA else None, no_doubt)
    for node, anchor in zip(graph.own.values(), ROW, strict=True):
        assert node.pose.y_m - anchor.y_m == pytest.approx(off_m, abs=0.08)


def test_closures_of_a_frame_that_is_left_wait_until_the_mate_has_followed():
    graph = walked(*ROW)
    graph.close(12, ROW[2], MATE, Pose2D(ROW[2].x_m + 0.1, ROW[2].y_m, ROW[2].yaw_rad), SURE)
    asked = []

    def place_of(key, frame):
        asked.append((key, frame))
        return IDENTITY if frame == OWN else None

    graph.solve(place_of, no_doubt)
    assert graph.own[12].pose.x_m == pytest.approx(ROW[2].x_m + 0.1, abs=0.01)
    graph.change_frame(OWN, ARENA, IDENTITY, ROW[2], JOINED)
    graph.solve(place_of, no_doubt)
    assert asked == [(MATE, OWN), (MATE, ARENA)]


def test_submaps_in_other_frames_stay():
    graph = walked(*ROW[:2], frame=ARENA)
    graph.begin(12, ROW[2], IDENTITY, 1, BEGINNING, MapFrame(12, "r1"))
    graph.begin(13, ROW[3], IDENTITY, 1, STEP, MapFrame(12, "r1"))
    there = Pose2D(1.0, 2.0, 0.3)
    before = graph.own[11].covariance
    graph.change_frame(MapFrame(12, "r1"), MapFrame(7, "r2"), there, there.compose(ROW[3]), JOINED)
    assert [node.frame for node in graph.own.values()] == [ARENA, ARENA, MapFrame(7, "r2"), MapFrame(7, "r2")]
    for node, place in zip(graph.own.values(), (IDENTITY, IDENTITY, there, there), strict=True):
        assert off(node.T_arena_local, place) == NOWHERE_OFF
    assert graph.own[11].covariance is before


def test_submaps_of_two_frames_are_not_closed_with_each_other():
    graph = walked(ROW[0], frame=ARENA)
    graph.begin(11, ROW[1], IDENTITY, 1, BEGINNING, OWN)
    graph.close(11, ROW[1], ("r1", 10), Pose2D(5.0, 3.0, 0.5), SURE)
    assert graph.solve(nowhere, no_doubt) == {}
    graph.change_frame(OWN, ARENA, IDENTITY, ROW[1], np.diag((4.0, 4.0, 0.04)))
    assert off(graph.solve(nowhere, no_doubt)[11].compose(ROW[1]), Pose2D(5.0, 3.0, 0.5)) == pytest.approx(
        (0.0, 0.0, 0.0), abs=0.05
    ), "as soon as they lie in one"


def test_a_trajectory_that_leaves_its_frame_stays_where_it_lies_without_closures_with_what_it_leaves():
    graph = walked(*ROW[:2], frame=ARENA)
    graph.begin(12, ROW[2], IDENTITY, 1, JOINED, ARENA)
    graph.begin(13, ROW[3], IDENTITY, 1, STEP, ARENA)
    graph.close(12, ROW[2], MATE, Pose2D(8.4, 1.0, -0.4), SURE)
    graph.close(13, ROW[3], ("r1", 10), Pose2D(12.2, 0.3, 0.0), SURE)
    graph.close(13, ROW[3], ("r1", 12), ROW[3], SURE)
    own = MapFrame(12, "r1")
    graph.part(1, own)
    assert graph.has_news
    assert [node.frame for node in graph.own.values()] == [ARENA, ARENA, own, own]
    assert not graph.rests_on("r2")
    asked = []
    moved = graph.solve(lambda key, frame: asked.append((key, frame)) or IDENTITY, no_doubt)
    assert moved == {}
    assert asked == []
    assert off(graph.own[13].pose, ROW[3]) == NOWHERE_OFF
    assert graph.own[12].covariance == pytest.approx(BEGINNING, rel=1e-3), "the frame is defined by it"


def test_a_trajectory_that_leaves_its_frame_keeps_what_holds_its_submaps_together():
    graph = walked(*ROW, frame=ARENA)
    graph.close(13, ROW[3], ("r1", 10), Pose2D(12.1, 0.1, 0.0), SURE)
    graph.part(0, OWN)
    graph.solve(nowhere, no_doubt)
    assert off(graph.own[13].pose, Pose2D(12.1, 0.1, 0.0)) == pytest.approx((0.0, 0.0, 0.0), abs=0.01)


def test_frames_are_ordered_by_when_they_began_and_the_arena_frame_comes_first():
    frames = [MapFrame(20, "r1"), MapFrame(10, "r3"), MapFrame(10, "r2"), ARENA]
    assert sorted(frames) == frames[::-1]
    assert MapFrame() == ARENA
