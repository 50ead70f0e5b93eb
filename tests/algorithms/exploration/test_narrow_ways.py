"""Memory of failed attempts at narrow passages."""

import pytest

from robrain.algorithms.exploration.narrow_passages import SHUT_RADIUS_M, TRIES, NarrowPassages
from robrain.protocol.model.geometry import Point2D

GOAL = Point2D(4.0, 2.0)
BESIDE = Point2D(4.0 + 0.4 * SHUT_RADIUS_M, 2.0)
FAR = Point2D(4.0 + 3.0 * SHUT_RADIUS_M, 2.0)


@pytest.fixture
def narrow() -> NarrowPassages:
    return NarrowPassages()


def test_a_goal_is_given_up_after_so_many_failures_and_not_before(narrow: NarrowPassages) -> None:
    assert not narrow.is_given_up(GOAL)
    for tries in range(1, TRIES + 1):
        narrow.record_failure(GOAL)
        assert narrow.is_given_up(GOAL) is (tries >= TRIES)


def test_failures_beside_each_other_count_together_and_others_do_not(narrow: NarrowPassages) -> None:
    for number in range(TRIES):
        narrow.record_failure(GOAL if number % 2 else BESIDE)
    assert narrow.is_given_up(GOAL)
    assert not narrow.is_given_up(FAR)


def test_a_gap_is_shut_for_a_while_and_after_so_many_tries_for_good(narrow: NarrowPassages) -> None:
    for tries in range(1, TRIES + 1):
        narrow.record_gap(GOAL, 0.4, again_ns=100)
        assert narrow.shut(99) == [(GOAL.x_m, GOAL.y_m, SHUT_RADIUS_M)]
        assert bool(narrow.shut(100)) is (tries >= TRIES)
    assert [(gap.gap_m, gap.tries) for gap in narrow.gaps] == [(0.4, TRIES)]


def test_gaps_that_are_apart_are_counted_apart(narrow: NarrowPassages) -> None:
    narrow.record_gap(GOAL, 0.4, again_ns=100)
    narrow.record_gap(FAR, 0.3, again_ns=200)
    assert [gap.tries for gap in narrow.gaps] == [1, 1]
    assert [x_m for x_m, _, _ in narrow.shut(150)] == [FAR.x_m]
