"""Submaps that freeze or are withdrawn, closures that are judged, and how sure all of it makes a robot."""

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.numeric.small_linear_algebra import symmetric
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph, is_information
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from tests.algorithms.slam.submap_walks import graph_of, no_doubt, nowhere, off

MATE, THIRD = ("r2", 7), ("r3", 1)
PRIOR = np.diag((0.01, 0.02, 0.0004))
STEP = np.diag((0.0025, 0.0016, 0.0001))
walked = partial(graph_of, PRIOR, STEP)
SURE = np.diag((1e4, 1e4, 1e6))
ROW = [Pose2D(0.0, 0.0, 0.0), Pose2D(4.0, 0.0, 0.5), Pose2D(8.0, 1.0, -0.4), Pose2D(12.0, 0.0, 0.0)]


def at_home(_key, _frame):
    return IDENTITY


def asked_of(graph):
    """The submaps of which the graph has closures, each as often as it is asked for."""
    asked = []

    def place_of(key, _frame):
        asked.append(key)
        return IDENTITY

    graph.solve(place_of, no_doubt)
    return asked


def test_before_a_robot_has_begun_it_makes_no_submap():
    assert SubmapGraph("r1", GraphSpec()).current is None
    assert SubmapGraph("r1", GraphSpec()).solve(nowhere, no_doubt) == {}


def test_an_error_of_yaw_moves_a_straight_way_of_several_submaps_as_one():
    graph = walked(*(Pose2D(3.0 * n, 0.0, 0.0) for n in range(5)))
    for_sure = walked(*(Pose2D(0.0, 0.0, 0.0) for _ in range(5)))
    across_m2 = graph.own[14].covariance[1, 1] - for_sure.own[14].covariance[1, 1]
    yaws_rad2 = [graph.own[10].covariance[2, 2]] + [0.0001] * 3
    assert across_m2 == pytest.approx(sum(v * (12.0 - 3.0 * n) ** 2 for n, v in enumerate(yaws_rad2)), rel=1e-6)


@settings(deadline=None, max_examples=30)
@given(yaw_rad=st.floats(-3.1, 3.1), anchor_rad=st.floats(-3.1, 3.1))
def test_how_unsure_the_start_is_is_said_in_the_axes_of_the_arena(yaw_rad, anchor_rad):
    graph = SubmapGraph("r1", GraphSpec())
    correlated = np.array([[0.04, 0.01, 0.002], [0.01, 0.02, -0.001], [0.002, -0.001, 0.01]])
    graph.begin(10, Pose2D(2.0, -1.0, anchor_rad), Pose2D(1.0, 3.0, yaw_rad), 0, correlated)
    graph.solve(nowhere, no_doubt)
    assert graph.own[10].covariance == pytest.approx(correlated, rel=1e-4, abs=1e-8)


def test_how_unsure_a_step_is_is_said_in_the_axes_of_the_frame_local():
    turned = Pose2D(0.0, 0.0, math.pi / 2)
    graph = SubmapGraph("r1", GraphSpec())
    graph.begin(10, Pose2D(0.0, 0.0, 0.3), turned, 0, 1e-9 * np.eye(3))
    graph.begin(11, Pose2D(0.0, 0.0, 1.0), turned, 0, np.diag((0.04, 0.01, 0.001)))
    graph.solve(nowhere, no_doubt)
    assert np.diag(graph.own[11].covariance) == pytest.approx((0.01, 0.04, 0.001), rel=1e-3)


def test_a_frozen_submap_takes_its_closures_along_and_leaves_those_of_others():
    graph = walked(*ROW[:3], spec=GraphSpec(submaps_max=3))
    graph.close(10, ROW[0], MATE, ROW[0], SURE)
    graph.close(12, ROW[2], THIRD, ROW[2], SURE)
    graph.begin(13, ROW[3], IDENTITY, 0, STEP)
    assert list(graph.own) == [11, 12, 13]
    assert not graph.rests_on("r2")
    assert graph.rests_on("r3")
    assert asked_of(graph).count(THIRD) == 1


def test_after_a_frozen_submap_the_others_follow_from_where_it_lies():
    graph = walked(*ROW[:3], spec=GraphSpec(submaps_max=2))
    there = Pose2D(0.5, -0.2, 0.1)
    graph.solve(lambda key, _frame: there if key == ("r1", 10) else None, no_doubt)
    for number, anchor in ((11, ROW[1]), (12, ROW[2])):
        assert off(graph.own[number].pose, there.compose(anchor)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


def test_closures_with_a_withdrawn_submap_are_withdrawn_from_either_end():
    graph = walked(*ROW)
    graph.close(13, ROW[3], ("r1", 11), ROW[3], SURE)
    graph.close(11, ROW[1], MATE, ROW[1], SURE)
    graph.close(12, ROW[2], THIRD, ROW[2], SURE)
    graph.close(12, ROW[2], ("r2", 11), ROW[2], SURE)
    graph.withdraw(11)
    assert list(graph.own) == [10, 12, 13]
    asked = asked_of(graph)
    assert MATE not in asked
    assert asked.count(THIRD) == asked.count(("r2", 11)) == 1
    graph.withdraw(99)
    assert list(graph.own) == [10, 12, 13]


def test_a_closure_over_a_long_way_is_not_taken_for_false_because_the_robot_drifted():
    """0.5 m is ten times what the scan may be off by, but not what the robot may be off by after so much way."""
    graph = SubmapGraph("r1", GraphSpec())
    for number in range(20):
        graph.begin(number, Pose2D(4.0 * number, 0.0, 0.0), IDENTITY, 0, np.diag((0.02, 0.02, 1e-5)))
    end = Pose2D(76.0, 0.0, 0.0)
    graph.close(19, end, MATE, Pose2D(76.5, 0.0, 0.0), np.diag((400.0, 400.0, 1e5)))
    moved = graph.solve(at_home, no_doubt)
    assert moved[19].x_m == pytest.approx(0.5, abs=0.05)


def test_the_same_closure_of_a_robot_that_is_sure_of_its_way_is_taken_for_false():
    graph = SubmapGraph("r1", GraphSpec())
    for number in range(20):
        graph.begin(number, Pose2D(4.0 * number, 0.0, 0.0), IDENTITY, 0, np.diag((1e-5, 1e-5, 1e-8)))
    graph.close(19, Pose2D(76.0, 0.0, 0.0), MATE, Pose2D(76.5, 0.0, 0.0), np.diag((400.0, 400.0, 1e5)))
    graph.solve(at_home, no_doubt)
    assert abs(graph.own[19].pose.x_m - 76.0) < 0.05


def test_a_mate_that_is_unsure_of_its_place_is_no_reason_to_doubt_a_closure():
    for variance_m2, is_believed in ((1e-6, False), (0.25, True)):
        graph = SubmapGraph("r1", GraphSpec())
        graph.begin(10, ROW[0], IDENTITY, 0, 1e-4 * np.eye(3))
        graph.close(10, ROW[0], MATE, Pose2D(1.0, 0.0, 0.0), SURE)
        graph.solve(at_home, lambda _key, m2=variance_m2: (m2, m2, 1e-6))
        assert graph.own[10].covariance[0, 0] < 1e-4
        share = 1e-4 / (1e-4 + variance_m2)
        assert (graph.own[10].covariance[0, 0] == pytest.approx(1e-4 * (1.0 - share), rel=1e-4)) == is_believed


@pytest.mark.parametrize("close", ["close", "add_robot_closure"])
@pytest.mark.parametrize("count", [1, 2, 9])
def test_all_closures_with_mates_make_a_robot_no_surer_than_one_mate_is(close, count):
    graph = SubmapGraph("r1", GraphSpec())
    graph.begin(10, ROW[0], IDENTITY, 0, np.eye(3))
    for number in range(count):
        getattr(graph, close)(10, ROW[0], (f"r{2 + number}", 1), IDENTITY, 1e6 * np.eye(3))
    graph.solve(at_home, lambda _key: (0.04, 0.03, 0.01))
    assert np.diag(graph.own[10].covariance) == pytest.approx((0.04 / 1.04, 0.03 / 1.03, 0.01 / 1.01), rel=1e-3), (
        "what it knew before counts beside them"
    )


@pytest.mark.parametrize(
    ("x_m", "yaw_rad", "is_moved"),
    [(0.0098, 0.0, False), (0.0105, 0.0, True), (0.0, 0.0019, False), (0.0, -0.0022, True)],
)
def test_a_submap_is_moved_where_it_would_move_by_enough(x_m, yaw_rad, is_moved):
    graph = walked(ROW[0], spec=GraphSpec(moved_m=0.01, moved_rad=0.002))
    graph.close(10, IDENTITY, MATE, Pose2D(x_m, 0.0, yaw_rad), 1e4 * SURE)
    assert (10 in graph.solve(at_home, no_doubt)) == is_moved


@pytest.mark.parametrize("close", ["close", "add_robot_closure"])
def test_a_closure_that_cannot_be_true_moves_little(close):
    graph = walked(*ROW[:3])
    getattr(graph, close)(12, ROW[2], MATE, Pose2D(ROW[2].x_m + 3.0, ROW[2].y_m - 2.0, ROW[2].yaw_rad), SURE)
    graph.solve(at_home, no_doubt)
    for node, anchor in zip(graph.own.values(), ROW, strict=False):
        assert node.pose.distance_m(anchor) < 0.5


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000))
def test_a_closure_adds_its_information_to_what_was_known(seed):
    """Whatever is correlated with what, on either side."""
    rng = np.random.default_rng(seed)
    prior, information = (root @ root.T + 0.3 * np.eye(3) for root in rng.normal(size=(2, 3, 3)))
    mates = rng.uniform(0.1, 1.0, 3)
    graph = SubmapGraph("r1", GraphSpec())
    graph.begin(10, IDENTITY, IDENTITY, 0, prior)
    graph.close(10, IDENTITY, MATE, IDENTITY, information)
    graph.solve(at_home, lambda _key: tuple(mates.tolist()))
    told = np.linalg.inv(np.linalg.inv(information) + np.diag(mates))
    assert graph.own[10].covariance == pytest.approx(np.linalg.inv(np.linalg.inv(prior) + told), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize(
    ("matrix", "is_one"),
    [
        (np.diag((1e9, 0.0, 0.0)), True),
        (np.diag((1.01e9, 0.0, 0.0)), False),
        (np.zeros((3, 3)), False),
        (np.diag((0.0, 0.0, 1.0)), True),
        (np.diag((1.0, -1e-12, 1.0)), False),
        (symmetric((1.0, 1.0, 0.0, 1.0, 0.0, 0.0)), True),
        (symmetric((1.0, 1.1, 0.0, 1.0, 0.0, 0.0)), False),
        (symmetric((1.0, 0.0, 1.1, 1.0, 0.0, 1.0)), False),
        (symmetric((1.0, 0.0, 0.0, 1.0, 1.1, 1.0)), False),
        (symmetric((1.0, -0.9, 0.9, 1.0, 0.9, 1.0)), False),  # each pair for itself would do
        (symmetric((1.0, 0.9, 0.9, 1.0, 0.0, 1.0)), False),
        (symmetric((1.0, 0.9, 0.0, 1.0, 0.9, 1.0)), False),
        (symmetric((1.0, 0.0, 0.9, 1.0, 0.9, 1.0)), False),
    ],
)
def test_information_is_what_a_covariance_can_be_the_inverse_of(matrix, is_one):
    assert is_information(matrix) is is_one
