"""Planning beside the coordinator's loop: the auction's plan at once, a better one later, the last question only."""

import pytest

from robrain.coordinator.planning.live_planner import TRIES, Done, LivePlanner
from robrain.coordinator.planning.plan_search import LockstepPlanner
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import PlanningRobot
from robrain.lab.recorded_plans import plan_again
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.geometry import Point2D
from tests.coordinator.planning.snapshots import open_floor_snapshot
from tests.waiting import PATIENCE_S


def wait_for(planner, made, until):
    plans = []
    while True:
        assert made.wait(PATIENCE_S)
        made.clear()
        plans += planner.finished_plans()
        if until(plans):
            return plans


@pytest.mark.slow
def test_an_answer_comes_before_the_search_is_over_and_a_better_one_after_it(planner, made):
    planner.ask(open_floor_snapshot(1, 30), PlanningPolicy(deadline_s=600.0))  # it gives up by itself
    plans = wait_for(planner, made, lambda found: found and found[-1].problem.rounds > 0)
    assert plans[0].problem.rounds == 0
    assert [plan_again(plan.problem) == plan.problem.routes for plan in plans] == [True] * len(plans)
    lockstep = LockstepPlanner()
    lockstep.ask(open_floor_snapshot(1, 30), PlanningPolicy(rounds=plans[-1].problem.rounds))
    assert lockstep.finished_plans()[0].problem.routes == plans[-1].problem.routes


@pytest.mark.slow
def test_of_many_questions_the_last_is_answered(planner, made):
    for number in range(1, 30):
        planner.ask(open_floor_snapshot(number, 12), PlanningPolicy(deadline_s=0.2))
    plans = wait_for(planner, made, lambda found: found and found[-1].problem.plan == 29)
    assert len({plan.problem.plan for plan in plans}) < 29


@pytest.mark.slow
def test_a_question_that_cannot_be_answered_does_not_end_planning(planner, made, caplog):
    bad = open_floor_snapshot(1, 2)
    bad.members["r0"] = PlanningRobot(RobotState(robot="r0"), None, (), Point2D(0.0, 0.0))  # it has no pose
    planner.ask(bad, PlanningPolicy())
    while not caplog.records:
        made.wait(0.01)
    planner.ask(open_floor_snapshot(2, 2), PlanningPolicy())
    plans = wait_for(planner, made, bool)
    assert plans[0].problem.plan == 2
    assert "no plan could be made" in caplog.text


@pytest.fixture
def lonely(monkeypatch):
    """A planner that starts no process."""
    monkeypatch.setattr(LivePlanner, "prepare", lambda _: None)
    return LivePlanner(lambda: None)


def lose(planner, times):
    for _ in range(times):
        planner._record_lost()


def test_a_question_that_three_processes_in_a_row_did_not_survive_is_given_up(lonely, caplog):
    lonely.ask(open_floor_snapshot(7, 1), PlanningPolicy())
    lose(lonely, TRIES - 1)
    assert lonely.is_busy
    assert caplog.records == []
    lose(lonely, 1)
    assert not lonely.is_busy
    assert [record.getMessage() for record in caplog.records] == [
        "no plan 7 could be made: 3 processes were lost over it"
    ]


def test_processes_lost_over_one_question_are_not_held_against_the_next(lonely, caplog):
    for number in (1, 2):
        lonely.ask(open_floor_snapshot(number, 1), PlanningPolicy())
        lose(lonely, TRIES - 1)
    assert lonely.is_busy
    assert caplog.records == []


def test_processes_that_are_lost_while_nothing_is_asked_cost_no_question(lonely, caplog):
    lose(lonely, TRIES)
    lonely.ask(open_floor_snapshot(1, 1), PlanningPolicy())
    lonely._receive(Done(1))
    lose(lonely, TRIES)
    assert caplog.records == []
    lonely.ask(open_floor_snapshot(2, 1), PlanningPolicy())
    lose(lonely, TRIES - 1)
    assert lonely.is_busy
