"""Planning beside the coordinator's loop: the auction's plan at once, a better one later, the last question only."""

import os
import signal
import time
from types import SimpleNamespace

import pytest

from robrain.coordinator.planning import live_planner
from robrain.coordinator.planning.live_planner import TRIES, Done, LivePlanner, Ready, Supposition
from robrain.coordinator.planning.plan_search import LockstepPlanner
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import PlanningRobot
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.geometry import Point2D
from tests.coordinator.planning.recorded_plans import plan_again
from tests.coordinator.planning.snapshots import open_floor_snapshot
from tests.waiting import PATIENCE_S, until


def wait_for(planner, made, until):
    plans = []
    while True:
        assert made.wait(PATIENCE_S)
        made.clear()
        plans += planner.finished_plans()
        if until(plans):
            return plans


@pytest.mark.slow
def test_of_questions_the_last_is_answered_before_its_search_is_over_and_better_after_it(planner, made, caplog):
    bad = open_floor_snapshot(1, 2)
    bad.members["r0"] = PlanningRobot(RobotState(robot="r0"), None, (), Point2D(0.0, 0.0))  # it has no pose
    planner.ask(bad, PlanningPolicy())
    until(lambda: caplog.records)
    assert "no plan could be made" in caplog.text
    for number in range(2, 30):
        planner.ask(open_floor_snapshot(number, 12), PlanningPolicy(deadline_s=0.2))
    planner.ask(open_floor_snapshot(30, 30), PlanningPolicy(deadline_s=600.0))  # it gives up by itself
    plans = wait_for(
        planner, made, lambda found: found and found[-1].problem.rounds > 0 and found[-1].problem.plan == 30
    )
    assert len({plan.problem.plan for plan in plans}) < 29
    plans = [plan for plan in plans if plan.problem.plan == 30]
    assert plans[0].problem.rounds == 0
    assert [plan_again(plan.problem) == plan.problem.routes for plan in plans] == [True] * len(plans)
    lockstep = LockstepPlanner()
    lockstep.ask(open_floor_snapshot(30, 30), PlanningPolicy(rounds=plans[-1].problem.rounds))
    assert lockstep.finished_plans()[0].problem.routes == plans[-1].problem.routes


@pytest.mark.slow
def test_suppositions_are_all_answered_beside_plans_and_those_of_a_lost_process_without_a_plan(planner, made):
    def supposed(count):
        found = []
        until(lambda: found.extend(planner.supposed()) or len(found) >= count, "a supposition has no answer")
        return found

    planner.suppose(Supposition(0, open_floor_snapshot(0, 2), PlanningPolicy(), "t0"))
    assert [(one.number, one.planned) for one in planner.supposed()] == [(0, None)], "the process starts"
    planner.ask(open_floor_snapshot(1, 12), PlanningPolicy(deadline_s=0.2))
    wait_for(planner, made, bool)
    planner.ask(open_floor_snapshot(2, 12), PlanningPolicy(deadline_s=0.2))
    for number in range(1, 6):
        planner.suppose(Supposition(number, open_floor_snapshot(number, number + 1), PlanningPolicy(), "t0"))
    found = supposed(5)
    assert [one.number for one in found] == [1, 2, 3, 4, 5]
    assert [len(one.planned.bids) for one in found] == [2] * 5
    assert sum(len(steps) for steps in found[4].planned.steps.values()) == 6
    wait_for(planner, made, lambda plans: any(plan.problem.plan == 2 for plan in plans))
    os.kill(planner.pid, signal.SIGKILL)
    planner.suppose(Supposition(6, open_floor_snapshot(6, 500), PlanningPolicy(), "t0"))
    (lost,) = supposed(1)
    assert lost.number == 6


class Process:
    """A process without a process: it replies at its start and to each request."""

    pid = 1
    is_lost = False

    def __init__(self, at_start, to_request, on_reply):
        self.asked, self._to_request, self._on_reply = [], to_request, on_reply
        self._reply(at_start)

    def _reply(self, replies):
        for reply in replies:
            self._on_reply(reply)

    def ask(self, request, _limit_s):
        self.asked.append(request.number)
        self._reply(self._to_request)

    def end(self):
        return ""

    kill = end


@pytest.fixture
def processes(monkeypatch):
    """Processes that were started, by a planner for which all limits are short; `replies` are theirs."""
    started = SimpleNamespace(all=[], at_start=[], to_request=[], kind=Process)

    def start(on_reply, on_lost):
        started.all.append(started.kind(started.at_start, started.to_request, on_reply))
        started.all[-1].on_lost = on_lost
        return started.all[-1]

    monkeypatch.setattr(live_planner, "PlannerProcess", start)
    for name, value in (("FIRST_PAUSE_S", 0.001), ("START_S", 0.04), ("GRACE_S", 0.02)):
        monkeypatch.setattr(live_planner, name, value)
    started.planner = LivePlanner(lambda: None)
    yield started
    started.planner.close()


def test_a_process_is_asked_once_when_it_is_ready_and_three_are_lost_before_a_request_is_given_up(processes, caplog):
    class LostSoon(Process):
        """It is ready when it is looked at for the second time, and lost at the fourth."""

        looks = 0

        @property
        def is_lost(self):
            self.looks += 1
            if self.looks == 2:
                assert self.asked == []
                self._reply([Ready()])
            self.on_lost()
            return self.looks > 3

    processes.kind = LostSoon
    processes.planner.ask(open_floor_snapshot(7, 1), PlanningPolicy())
    until(lambda: len(processes.all) > TRIES)
    assert [process.asked for process in processes.all[: TRIES + 1]] == [*[[1]] * TRIES, []]
    assert not processes.planner.is_busy
    assert "no plan 7 could be made: 3 processes were lost over it" in caplog.text


@pytest.mark.parametrize(
    ("at_start", "to_request", "limit_s"),
    [([], [], 0.04), ([Ready()], [], 0.12), ([Ready()], [Done(1)], None)],
    ids=["starts", "searches", "is idle"],
)
def test_a_process_that_starts_or_searches_is_replaced_when_it_is_silent_and_an_idle_one_is_not(
    processes, caplog, at_start, to_request, limit_s
):
    processes.at_start, processes.to_request = at_start, to_request
    processes.planner.ask(open_floor_snapshot(1, 1), PlanningPolicy(deadline_s=0.1))
    if limit_s is None:
        time.sleep(0.13)  # longer than each limit
        assert (len(processes.all), processes.planner.is_busy) == (1, False)
        return
    until(lambda: len(processes.all) > 1)
    assert f"the planner's process has sent nothing for {limit_s:g} s; there is another in 0.001 s" in caplog.text


def test_a_planner_that_cannot_be_started_is_tried_again_and_says_so(processes, caplog):
    def fail(*_):
        processes.kind = Process
        raise OSError("no memory")

    processes.kind, processes.at_start, processes.to_request = fail, [Ready()], [Done(1)]
    processes.planner.ask(open_floor_snapshot(1, 1), PlanningPolicy())
    until(lambda: not processes.planner.is_busy)
    assert "the planner's process cannot be started: no memory; there is another in 0.001 s" in caplog.text
