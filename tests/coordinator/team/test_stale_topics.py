"""A state older than three periods is named, with its sender and its age, while the robot is there."""

import logging

import pytest

from robrain.coordinator.team.roster import Roster, StaleTopics
from robrain.protocol.clock import to_ns
from robrain.protocol.reasons import TopicStale
from tests.coordinator.team.test_roster import comes, goes, says


@pytest.fixture
def roster():
    one = Roster()
    for name in ("r1", "r2"):
        comes(one, name)
        says(one, name, 1.0)
    return one


def test_robot_whose_state_is_older_than_three_periods_is_named_until_it_speaks_again(roster):
    watch = StaleTopics(roster)
    assert not watch.check(to_ns(1.3))
    assert watch.found == []
    says(roster, "r2", 1.35)
    assert watch.check(to_ns(1.41))
    assert watch.found == [TopicStale("robot_state", "r1", 0.41, 0.3)]
    assert str(watch.found[0]) == "robot_state of r1 is 0.4 s old, more than 0.3 s"
    assert not watch.check(to_ns(1.52))
    assert watch.found[0].age_s == 0.52
    says(roster, "r1", 1.6)
    assert watch.check(to_ns(1.63))
    assert watch.found == []


def test_robot_that_is_not_counted_on_any_more_is_told_at_once_and_once(roster):
    watch = StaleTopics(roster)
    assert watch.check(to_ns(1.5))
    assert not watch.check(to_ns(1.79))
    assert watch.check(to_ns(1.91))
    assert not watch.check(to_ns(2.1))


def test_robot_that_has_left_or_has_not_spoken_yet_is_not_stale(roster):
    comes(roster, "r3")
    goes(roster, "r2")
    watch = StaleTopics(roster)
    watch.check(to_ns(5.0))
    assert [found.sender for found in watch.found] == ["r1"]


def test_robots_that_come_and_go_are_logged_once_in_ten_seconds(roster, caplog):
    watch = StaleTopics(roster)
    with caplog.at_level(logging.WARNING):
        for second in range(2, 14):
            watch.check(to_ns(second + 0.9))
            for name in ("r1", "r2"):
                says(roster, name, second + 1.0)
            watch.check(to_ns(second + 1.1))
    assert [record.levelname for record in caplog.records] == ["WARNING", "WARNING"]
    assert "robot_state of r1 is 1.9 s old" in caplog.messages[0]
