from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.numeric.small_linear_algebra import symmetric
from robrain.algorithms.slam.submap_graph import GraphSpec
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from tests.algorithms.slam.submap_walks import graph_of, no_doubt, nowhere, off

MATE = ("r2", 7)
PRIOR = np.diag((0.01, 0.01, 0.0004))
STEP = np.diag((0.0025, 0.0025, 0.0001))
walked = partial(graph_of, PRIOR, STEP)
SURE = np.diag((1e4, 1e4, 1e6))
PLACE = st.builds(Pose2D, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-3.1, 3.1))


def at(place):
    return lambda key, _frame: place if key == MATE else None


ROW = [Pose2D(1.0, 2.0, 0.3), Pose2D(5.0, 2.0, -0.4), Pose2D(9.0, 3.0, 1.0)]


def test_without_loop_closures_no_submap_is_moved():
    graph = walked(*ROW)
    assert not graph.has_news
    assert graph.current.number == 12
    assert graph.solve(nowhere, no_doubt) == {}
    assert [off(node.pose, place) for node, place in zip(graph.own.values(), ROW, strict=True)] == [
        pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    ] * 3


def test_a_closure_moves_a_submap_to_where_a_mate_says_and_those_before_it_by_their_share():
    graph = walked(Pose2D(0.0, 0.0, 0.0), Pose2D(4.0, 0.0, 0.0), Pose2D(8.0, 0.0, 0.0))
    assert graph.rests_on("r2") is False
    # The mate's submap lies 0.1 m farther along than this robot's own map has it.
    graph.close(12, Pose2D(8.5, 0.0, 0.0), MATE, Pose2D(8.5, 0.0, 0.0), SURE)
    assert graph.has_news
    assert graph.rests_on("r2")
    moved = graph.solve(at(Pose2D(0.1, 0.0, 0.0)), no_doubt)
    assert not graph.has_news
    # Variances along the way add up: 0.01 for the start, 0.0025 for each step.
    shares = {10: 0.01 / 0.015, 11: 0.0125 / 0.015, 12: 1.0}
    assert set(moved) == set(shares)
    for number, share in shares.items():
        assert off(moved[number], Pose2D(0.1 * share, 0.0, 0.0)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
        assert graph.own[number].T_arena_local == moved[number]
    assert graph.solve(at(Pose2D(0.1, 0.0, 0.0)), no_doubt) == {}, "it lies there already"
    assert graph.current.covariance[0, 0] == pytest.approx(1e-4, rel=0.01)


@settings(deadline=None, max_examples=40)
@given(anchor=PLACE, sensor=PLACE, wrong=st.builds(Pose2D, *[st.floats(-0.05, 0.05)] * 3), mate=PLACE)
def test_a_closure_found_by_the_mate_says_the_same_as_one_found_by_the_robot(anchor, sensor, wrong, mate):
    """The scan's place in both frames is the same, whoever made it; the difference has no direction here."""
    seen_from_mate = mate.inverse().compose(sensor.compose(wrong))
    even = np.diag((400.0, 400.0, 2500.0))
    hundredth = 0.01 / 400.0  # of the closure's variance
    graphs = walked(anchor), walked(anchor)
    graphs[0].close(10, sensor, MATE, seen_from_mate, even)
    graphs[1].add_robot_closure(10, sensor, MATE, seen_from_mate, even)
    found = [graph.solve(at(mate), no_doubt) or {10: IDENTITY} for graph in graphs]
    assert found[0][10].compose(anchor).distance_m(found[1][10].compose(anchor)) < 0.012
    assert graphs[0].own[10].covariance == pytest.approx(graphs[1].own[10].covariance, rel=0.05, abs=hundredth)


def test_a_closure_with_an_old_submap_of_its_own_closes_a_loop():
    places = [Pose2D(0.0, 0.0, 0.0), Pose2D(4.0, 0.0, 0.0), Pose2D(4.0, 4.0, 0.0), Pose2D(0.0, 4.0, 0.0)]
    graph = walked(*places)
    # At the end it sees what it saw at the start, a little to the right.
    graph.close(13, Pose2D(0.0, 1.0, 0.0), ("r1", 10), Pose2D(0.1, 1.0, 0.0), SURE)
    moved = graph.solve(nowhere, no_doubt)
    assert 10 not in moved, "the start is where it was"
    assert graph.own[13].T_arena_local.compose(Pose2D(0.0, 1.0, 0.0)).distance_m(Pose2D(0.1, 1.0, 0.0)) < 0.004
    xs_m = [graph.own[number].pose.x_m - place.x_m for number, place in zip(range(10, 14), places, strict=True)]
    assert xs_m == sorted(xs_m)
    assert not graph.rests_on("r2")


def test_a_false_closure_between_true_ones_moves_next_to_nothing():
    graph = walked(*ROW)
    for number, anchor in zip((10, 11, 12), ROW, strict=True):
        graph.close(number, anchor, MATE, anchor, np.diag((2500.0, 2500.0, 1e5)))
    graph.close(12, ROW[2], ("r3", 1), Pose2D(ROW[2].x_m + 3.0, ROW[2].y_m - 2.0, 0.0), np.diag((2500.0, 2500.0, 1e5)))
    graph.solve(lambda _key, _frame: IDENTITY, no_doubt)
    for node, anchor in zip(graph.own.values(), ROW, strict=True):
        assert off(node.pose, anchor) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_of_a_pair_of_submaps_the_latest_closures_are_kept_and_they_stand_apart():
    graph = walked(Pose2D(0.0, 0.0, 0.0), spec=GraphSpec(closures_per_pair=2, apart_m=1.0))
    even = np.diag((1e3, 1e3, 1e3))

    def lies_at(offset_m):
        graph.solve(at(Pose2D(offset_m, 0.0, 0.0)), no_doubt)
        return graph.own[10].T_arena_local.x_m

    graph.close(10, Pose2D(0.0, 0.0, 0.0), MATE, Pose2D(0.0, 0.0, 0.0), even)
    graph.close(10, Pose2D(0.5, 0.0, 0.0), MATE, Pose2D(0.53, 0.0, 0.0), even)  # in place of the first, which is near
    assert lies_at(0.0) == pytest.approx(0.03, abs=4e-3)
    graph.close(10, Pose2D(2.0, 0.0, 0.0), MATE, Pose2D(2.06, 0.0, 0.0), even)
    assert lies_at(0.0) == pytest.approx(0.045, abs=4e-3)
    graph.close(10, Pose2D(4.0, 0.0, 0.0), MATE, Pose2D(4.0, 0.0, 0.0), even)  # in place of the oldest
    assert lies_at(0.0) == pytest.approx(0.03, abs=4e-3)


@pytest.mark.parametrize("close", ["close", "add_robot_closure"])
def test_memory_for_closures_is_bounded(close):
    graph = walked(*(Pose2D(float(n), 0.0, 0.0) for n in range(20)), spec=GraphSpec(closures_max=5))
    for number in range(20):
        getattr(graph, close)(10 + number, IDENTITY, ("r2", number), IDENTITY, SURE)
    asked = []
    graph.solve(lambda key, _frame: asked.append(key) or IDENTITY, no_doubt)
    assert asked == [("r2", number) for number in range(15, 20)]


def test_a_mate_that_tells_of_many_closures_displaces_its_own_ones_only():
    graph = walked(*(Pose2D(float(n), 0.0, 0.0) for n in range(20)), spec=GraphSpec(closures_max=5))
    graph.close(10, IDENTITY, MATE, IDENTITY, SURE)
    graph.add_robot_closure(11, IDENTITY, ("r3", 1), IDENTITY, SURE)
    for number in range(20):
        graph.add_robot_closure(10 + number, IDENTITY, ("r4", number), IDENTITY, SURE)
    asked = []
    graph.solve(lambda key, _frame: asked.append(key) or IDENTITY, no_doubt)
    assert asked == [MATE, ("r3", 1), ("r4", 17), ("r4", 18), ("r4", 19)]


def test_closures_of_submaps_that_are_not_its_own_any_more_are_left_out():
    graph = walked(*ROW)
    graph.close(99, IDENTITY, MATE, IDENTITY, SURE)
    graph.add_robot_closure(99, IDENTITY, MATE, IDENTITY, SURE)
    assert not graph.has_news
    assert not graph.rests_on("r2")


def test_nothing_rests_on_a_submap_that_was_withdrawn():
    graph = walked(*ROW)
    graph.close(12, ROW[2], ("r1", 10), ROW[2], SURE)
    graph.close(10, ROW[0], MATE, ROW[0], SURE)
    graph.withdraw(10)
    assert set(graph.own) == {11, 12}
    assert not graph.rests_on("r2")
    graph.withdraw(11)
    graph.withdraw(12)
    assert graph.current is None
    assert graph.solve(nowhere, no_doubt) == {}


def test_submaps_after_one_that_was_withdrawn_can_still_be_placed():
    graph = walked(*ROW)
    graph.withdraw(10)
    graph.close(12, ROW[2], MATE, ROW[2], np.diag((1e4, 1e4, 1e6)))
    graph.solve(at(IDENTITY), no_doubt)
    assert graph.own[12].covariance[0, 0] < 0.001
    graph.withdraw(12)
    graph.begin(13, Pose2D(10.0, 3.0, 1.0), IDENTITY, 0, STEP)
    graph.close(13, Pose2D(10.0, 3.0, 1.0), MATE, Pose2D(10.1, 3.0, 1.0), SURE)
    assert 13 in graph.solve(at(IDENTITY), no_doubt)


def test_the_oldest_submaps_stay_where_they_are_and_hold_those_after_them():
    graph = walked(*ROW, spec=GraphSpec(submaps_max=2))
    assert set(graph.own) == {11, 12}
    graph.close(12, ROW[2], MATE, Pose2D(ROW[2].x_m + 0.1, ROW[2].y_m, ROW[2].yaw_rad), np.diag((400.0, 400.0, 1e4)))
    moved = graph.solve(lambda _key, _frame: IDENTITY, no_doubt)
    assert 10 not in moved
    assert 12 in moved
    assert 0.0 < moved[12].compose(ROW[2]).x_m - ROW[2].x_m < 0.1


def test_a_new_trajectory_begins_where_the_robot_was_found_and_does_not_pull_at_the_one_before():
    graph = walked(*ROW)
    found = Pose2D(20.0, 1.0, 2.0)
    graph.begin(13, found, IDENTITY, 1, np.diag((0.04, 0.04, 0.01)))
    graph.close(13, found, MATE, Pose2D(20.1, 1.0, 2.0), SURE)
    assert set(graph.solve(at(IDENTITY), no_doubt)) == {13}
    assert graph.own[13].pose.x_m == pytest.approx(20.1, abs=2e-3)
    assert graph.own[13].covariance[0, 0] == pytest.approx(1e-4, rel=0.01)


def test_a_mates_closure_of_negative_information_does_not_keep_the_robot_from_placing_its_submaps():
    graph = walked(*ROW)
    graph.close(12, ROW[2], MATE, Pose2D(9.1, 3.0, 1.0), SURE)
    hostile = symmetric((-1e12, 0.0, 0.0, -1e12, 0.0, -1e12))
    graph.add_robot_closure(11, ROW[1], ("r3", 1), ROW[1], hostile)
    assert 12 in graph.solve(lambda _key, _frame: IDENTITY, no_doubt)
