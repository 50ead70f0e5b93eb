"""Own submaps whose map frame changes: a whole frame joins another one, or a trajectory leaves its frame."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.numeric.small_linear_algebra import symmetric
from robrain.algorithms.slam.submap_graph import BEGINNING, GraphSpec, SubmapGraph, is_information
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.map_frame import ARENA, MapFrame
from tests.algorithms.slam.submap_walks import graph_of, no_doubt, nowhere, off

MATE, THIRD = ("r2", 7), ("r3", 1)
PRIOR = np.diag((0.01, 0.02, 0.0004))
STEP = np.diag((0.0025, 0.0016, 0.0001))
walked = partial(graph_of, PRIOR, STEP)
SURE = np.diag((1e4, 1e4, 1e6))


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
    # The teammate's submap lies 0.1 m farther along than this robot's own map has it.
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


def test_a_mate_that_tells_of_many_closures_displaces_its_own_ones_only():
    graph = walked(*(Pose2D(float(n), 0.0, 0.0) for n in range(20)), spec=GraphSpec(closures_max=5))
    graph.close(10, IDENTITY, MATE, IDENTITY, SURE)
    graph.add_robot_closure(11, IDENTITY, ("r3", 1), IDENTITY, SURE)
    for number in range(20):
        graph.add_robot_closure(10 + number, IDENTITY, ("r4", number), IDENTITY, SURE)
    asked = []
    graph.solve(lambda key, _frame: asked.append(key) or IDENTITY, no_doubt)
    assert asked == [MATE, ("r3", 1), ("r4", 17), ("r4", 18), ("r4", 19)]


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


OWN = MapFrame(10, "r1")
walked_in_own_frame = partial(graph_of, BEGINNING, STEP, frame=OWN)
JOINED = np.diag((0.01, 0.01, 0.0004))
WALK = [Pose2D(0.0, 0.0, 0.0), Pose2D(4.0, 0.0, 0.5), Pose2D(8.0, 1.0, -0.4), Pose2D(12.0, 0.0, 0.0)]
POSES = st.builds(Pose2D, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-3.1, 3.1))


NOWHERE_OFF = pytest.approx((0.0, 0.0, 0.0), abs=1e-4)


@settings(deadline=None, max_examples=30)
@given(POSES, st.integers(0, 3))
def test_a_frame_that_joins_another_takes_all_its_submaps_along_and_they_stay_there(move, found_at):
    graph = walked_in_own_frame(*WALK)
    graph.change_frame(OWN, ARENA, move, move.compose(WALK[found_at]), JOINED)
    for _ in range(2):
        for node, anchor in zip(graph.own.values(), WALK, strict=True):
            assert node.frame == ARENA
            assert off(node.pose, move.compose(anchor)) == NOWHERE_OFF
            assert off(node.T_arena_local, move) == NOWHERE_OFF
        assert graph.solve(nowhere, no_doubt) == {}


def test_closures_of_a_frame_that_is_left_wait_until_the_mate_has_followed():
    graph = walked_in_own_frame(*WALK)
    graph.close(12, WALK[2], MATE, Pose2D(WALK[2].x_m + 0.1, WALK[2].y_m, WALK[2].yaw_rad), SURE)
    asked = []

    def place_of(key, frame):
        asked.append((key, frame))
        return IDENTITY if frame == OWN else None

    graph.solve(place_of, no_doubt)
    assert graph.own[12].pose.x_m == pytest.approx(WALK[2].x_m + 0.1, abs=0.01)
    graph.change_frame(OWN, ARENA, IDENTITY, WALK[2], JOINED)
    graph.solve(place_of, no_doubt)
    assert asked == [(MATE, OWN), (MATE, ARENA)]


def test_a_trajectory_that_leaves_its_frame_stays_where_it_lies_without_closures_with_what_it_leaves():
    graph = walked_in_own_frame(*WALK[:2], frame=ARENA)
    graph.begin(12, WALK[2], IDENTITY, 1, JOINED, ARENA)
    graph.begin(13, WALK[3], IDENTITY, 1, STEP, ARENA)
    graph.close(12, WALK[2], MATE, Pose2D(8.4, 1.0, -0.4), SURE)
    graph.close(13, WALK[3], ("r1", 10), Pose2D(12.2, 0.3, 0.0), SURE)
    graph.close(13, WALK[3], ("r1", 12), WALK[3], SURE)
    own = MapFrame(12, "r1")
    graph.part(1, own)
    assert graph.has_news
    assert [node.frame for node in graph.own.values()] == [ARENA, ARENA, own, own]
    assert not graph.rests_on("r2")
    asked = []
    moved = graph.solve(lambda key, frame: asked.append((key, frame)) or IDENTITY, no_doubt)
    assert moved == {}
    assert asked == []
    assert off(graph.own[13].pose, WALK[3]) == NOWHERE_OFF
    assert graph.own[12].covariance == pytest.approx(BEGINNING, rel=1e-3), "the frame is defined by it"


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


def test_closures_with_a_withdrawn_submap_are_withdrawn_from_either_end():
    graph = walked(*WALK)
    graph.close(13, WALK[3], ("r1", 11), WALK[3], SURE)
    graph.close(11, WALK[1], MATE, WALK[1], SURE)
    graph.close(12, WALK[2], THIRD, WALK[2], SURE)
    graph.close(12, WALK[2], ("r2", 11), WALK[2], SURE)
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


@pytest.mark.parametrize("close", ["close", "add_robot_closure"])
@pytest.mark.parametrize("count", [1, 2, 9])
def test_all_closures_with_mates_make_a_robot_no_surer_than_one_mate_is(close, count):
    graph = SubmapGraph("r1", GraphSpec())
    graph.begin(10, WALK[0], IDENTITY, 0, np.eye(3))
    for number in range(count):
        getattr(graph, close)(10, WALK[0], (f"r{2 + number}", 1), IDENTITY, 1e6 * np.eye(3))
    graph.solve(at_home, lambda _key: (0.04, 0.03, 0.01))
    assert np.diag(graph.own[10].covariance) == pytest.approx((0.04 / 1.04, 0.03 / 1.03, 0.01 / 1.01), rel=1e-3), (
        "what it knew before counts beside them"
    )


@pytest.mark.parametrize("close", ["close", "add_robot_closure"])
def test_a_closure_that_cannot_be_true_moves_little(close):
    graph = walked(*WALK[:3])
    getattr(graph, close)(
        12,
        WALK[2],
        MATE,
        Pose2D(WALK[2].x_m + 3.0, WALK[2].y_m - 2.0, WALK[2].yaw_rad),
        SURE,
    )
    graph.solve(at_home, no_doubt)
    for node, anchor in zip(graph.own.values(), WALK, strict=False):
        assert node.pose.distance_m(anchor) < 0.5


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000))
def test_a_closure_adds_its_information_to_what_was_known(seed):
    """Whatever is correlated with what, on either side."""
    rng = np.random.default_rng(seed)
    prior, information = (root @ root.T + 0.3 * np.eye(3) for root in rng.normal(size=(2, 3, 3)))
    teammates = rng.uniform(0.1, 1.0, 3)
    graph = SubmapGraph("r1", GraphSpec())
    graph.begin(10, IDENTITY, IDENTITY, 0, prior)
    graph.close(10, IDENTITY, MATE, IDENTITY, information)
    graph.solve(at_home, lambda _key: tuple(teammates.tolist()))
    shared = np.linalg.inv(np.linalg.inv(information) + np.diag(teammates))
    assert graph.own[10].covariance == pytest.approx(np.linalg.inv(np.linalg.inv(prior) + shared), rel=1e-4, abs=1e-6)


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


def test_a_frozen_submap_takes_its_closures_along_and_leaves_those_of_others():
    graph = walked(*WALK[:3], spec=GraphSpec(submaps_max=3))
    graph.close(10, WALK[0], MATE, WALK[0], SURE)
    graph.close(12, WALK[2], THIRD, WALK[2], SURE)
    graph.begin(13, WALK[3], IDENTITY, 0, STEP)
    assert list(graph.own) == [11, 12, 13]
    assert not graph.rests_on("r2")
    assert graph.rests_on("r3")
    assert asked_of(graph).count(THIRD) == 1
