"""Planning beside the coordinator's loop: the auction's plan at once, a better one later, the last question only."""

from robrain.coordinator.planning.lockstep_planner import LockstepPlanner
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.replaying import plan_again
from robrain.coordinator.planning.situation import Member
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.messages import RobotState
from tests.coordinator.planning.situations import open_floor_situation
from tests.waiting import PATIENCE_S


def wait_for(planner, made, until):
    plans = []
    while True:
        assert made.wait(PATIENCE_S)
        made.clear()
        plans += planner.take()
        if until(plans):
            return plans


def test_an_answer_comes_before_the_search_is_over_and_a_better_one_after_it(planner, made):
    planner.ask(open_floor_situation(1, 30), PlanningPolicy(deadline_s=2.0))
    plans = wait_for(planner, made, lambda found: found and found[-1].problem.rounds > 0)
    assert plans[0].problem.rounds == 0
    assert [plan_again(plan.problem) == plan.problem.routes for plan in plans] == [True] * len(plans)
    lockstep = LockstepPlanner()
    lockstep.ask(open_floor_situation(1, 30), PlanningPolicy(rounds=plans[-1].problem.rounds))
    assert lockstep.take()[0].problem.routes == plans[-1].problem.routes


def test_of_many_questions_the_last_is_answered(planner, made):
    for number in range(1, 30):
        planner.ask(open_floor_situation(number, 12), PlanningPolicy(deadline_s=0.2))
    plans = wait_for(planner, made, lambda found: found and found[-1].problem.plan == 29)
    assert len({plan.problem.plan for plan in plans}) < 29


def test_a_question_that_cannot_be_answered_does_not_end_planning(planner, made, caplog):
    bad = open_floor_situation(1, 2)
    bad.members["r0"] = Member(RobotState(robot="r0"), None, (), Point2D(0.0, 0.0))  # it has no pose
    planner.ask(bad, PlanningPolicy())
    while not caplog.records:
        made.wait(0.01)
    planner.ask(open_floor_situation(2, 2), PlanningPolicy())
    plans = wait_for(planner, made, bool)
    assert plans[0].problem.plan == 2
    assert "no plan could be made" in caplog.text
