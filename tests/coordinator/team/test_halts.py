"""The coordinator follows emergency halts, and tells who has not stopped."""

import msgspec
import pytest

from robrain.protocol.messages.team.team_messages import COORDINATOR_HALT, HALT, Halt


@pytest.fixture
def say(team):
    publisher = team.endpoint().publisher(HALT)

    def say(*, halted, by="ann", reason=""):
        publisher.put(Halt(halted=halted, by=by, reason=reason))
        team.run(0.02)

    return say


def test_nothing_is_said_of_halts_before_the_first_one(team):
    team.run(1.0)
    assert team.summary.halt is None


def test_the_team_is_told_at_once_who_halted_it_and_who_has_not_stopped(team, say):
    obedient, _ = team.robot("r1"), team.robot("r2")
    team.run(1.1)
    obedient.halted = True
    say(halted=True, reason="smoke")
    halt = team.summary.halt
    assert (halt.halted, halt.by, halt.reason, halt.since_ns) == (True, ["ann"], "smoke", halt.stamp_ns)
    team.run(0.1)
    halt = team.summary.halt  # said again because it has changed
    assert (halt.stopped, halt.not_stopped) == (["r1"], ["r2"])


def test_a_robot_that_is_lost_has_not_stopped_whatever_it_said_last(team, say):
    robot = team.robot("r1")
    robot.halted = True
    say(halted=True)
    team.run(1.0)
    assert team.summary.halt.stopped == ["r1"]
    robot.speaks = False
    team.run(3.0)
    assert team.summary.halt.not_stopped == ["r1"]


def test_a_robot_with_a_plugin_that_does_not_stop_has_not_stopped(team, say):
    robot = team.robot("r1")
    robot.halted, robot.not_halted = True, ["arm"]
    say(halted=True)
    team.run(1.0)
    assert team.summary.halt.not_stopped == ["r1"]


def test_a_halt_ends_by_who_halted_or_an_operator_only(team, say):
    say(halted=True)
    say(halted=False, by="bob")
    team.run(1.0)
    assert team.summary.halt.halted
    say(halted=False, by="operator:bob")
    team.run(1.0)
    halt = team.summary.halt
    assert (halt.halted, halt.by) == (False, ["operator:bob"])


def test_a_halted_team_is_handed_nothing_not_even_a_robot_that_has_not_heard_of_it(team, say):
    robot = team.robot("r1")
    say(halted=True)
    team.hall()
    team.run(4.0)
    assert robot.offers == []
    assert not team.summary.all_explored
    say(halted=False)
    team.run(1.0)
    assert len(robot.offers) == 1


def test_whoever_asks_is_told_how_the_team_stands(team, say):
    asker = team.endpoint()
    assert asker.ask(COORDINATOR_HALT) is None
    say(halted=True)
    assert asker.ask(COORDINATOR_HALT).halted


def test_a_coordinator_that_comes_during_a_halt_takes_it_over_from_the_robots(team, say):
    robot = team.robot("r1")
    robot.halted, robot.halted_by, robot.team_halt_ns = True, ["ann"], 10
    team.run(1.0)
    halt = team.summary.halt
    assert (halt.halted, halt.by, halt.stopped) == (True, ["ann"], ["r1"])


def test_a_halt_that_is_over_is_not_taken_over_from_a_robot_that_missed_its_end(team, say):
    say(halted=True)
    robot = team.robot("r1")
    robot.halted, robot.halted_by, robot.team_halt_ns = True, ["ann"], team.clock.now_ns()
    say(halted=False)
    team.run(1.0)
    assert not team.summary.halt.halted


def test_a_halt_counts_as_later_than_what_was_heard_before_it_whatever_its_senders_clock_says(team, say):
    late = team.endpoint().publisher(HALT)
    say(halted=True)
    say(halted=False)
    stamp_ns = team.coordinator.halts.status(team.clock.now_ns()).stamp_ns
    late.put_bytes(msgspec.json.encode(Halt(stamp_ns=1, halted=True, by="bob")))
    team.run(0.02)
    assert team.coordinator.halts.status(team.clock.now_ns()).stamp_ns > stamp_ns
