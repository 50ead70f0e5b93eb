"""What all behaviors that do tasks have in common, shown with the simplest of them."""

import pytest

from robrain.protocol.clock import to_seconds
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.model.geometry import Point2D, Twist2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import NeedsEnergy, no_path
from tests.plain_reason import Plain
from tests.plugins.behavior.errands import Errands

FAR = Point2D(5.0, 3.0)
WALLED = Point2D(-300.0, 1.0)
NEXT_ROOM = Point2D(10.0, 2.0)
UNSEEN = Point2D(5.6, 2.0)
"""Behind the pillar, where the robot has not looked."""


def usable(run: Errands, energy_j: float) -> None:
    """Have the robot believe that its battery surely gives so much."""
    run.plugin("energy").usable_j = lambda: energy_j


def behavior(run: Errands) -> str:
    return run.robot().board.behavior


# -- one task -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_visit_goes_there_stays_and_tells_what_it_took(errands):
    run = errands("visit")
    battery = run.robot().board.battery
    status = run.finish(Task(id="v", kind="visit", place=FAR, service_s=3.0))
    assert (status.state, status.why) == (TaskState.DONE, "")
    assert run.pose().distance_m(FAR) < 0.15
    assert status.result["off_m"] == pytest.approx(run.pose().distance_m(FAR), abs=0.05)
    assert status.result["path_length_m"] == pytest.approx(run.path_m(), rel=0.05)
    assert battery is not None
    assert status.result["energy_j"] > 3.0 * 5.0
    assert behavior(run) == "idle"


@pytest.mark.slow
def test_what_a_way_has_cost_is_a_lesson_for_the_next_one(errands):
    run = errands("visit")
    energy, told = run.plugin("energy"), []
    energy.outcome = lambda work, cost_j: told.append((work, cost_j))
    status = run.finish(Task(id="v", kind="visit", place=FAR, service_s=5.0))
    ((work, cost_j),) = told
    assert work.path_m == pytest.approx(run.path_m(), rel=0.15)
    assert work.wait_s == 0.0
    assert 0.5 * status.result["energy_j"] < cost_j < status.result["energy_j"] - 5.0 * 5.0
    run.finish(Task(id="here", kind="visit", place=FAR))
    assert len(told) == 1  # that was no way to learn from


@pytest.mark.slow
def test_a_task_that_must_not_begin_yet_waits_at_its_place(errands):
    run = errands("visit")
    begin_ns = 20_000_000_000
    run.finish(Task(id="v", kind="visit", place=Point2D(2.5, 1.0), earliest_ns=begin_ns))
    assert begin_ns <= run.clock.now_ns() < begin_ns + 1_500_000_000


def test_a_place_that_cannot_be_reached_is_refused(errands):
    run = errands("visit")
    assert run.offer(Task(id="v", kind="visit", place=WALLED)).reason == no_path()
    assert run.robot().desk.status is None


def test_a_place_that_is_not_on_the_map_yet_is_refused_as_unexplored(errands):
    run = errands("visit", parameters={"mapper": {"width_m": 20.0}})
    answer = run.offer(Task(id="v", kind="visit", place=NEXT_ROOM))
    assert (answer.reason, answer.why) == (Plain("unexplored"), "no way there, as its place is not explored yet")


@pytest.mark.parametrize(("to", "reason"), [(NEXT_ROOM, Plain("unexplored")), (WALLED, no_path())])
def test_a_delivery_to_a_place_that_cannot_be_reached_is_refused(errands, to, reason):
    run = errands("deliver", parameters={"mapper": {"width_m": 20.0}})
    task = Task(id="d", kind="deliver", place=Point2D(2.5, 1.0), parameters={"to": {"x_m": to.x_m, "y_m": to.y_m}})
    assert run.offer(task).reason == reason


# -- ends before its time -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_task_that_is_withdrawn_is_let_go_and_the_robot_stands(errands):
    run = errands("visit")
    run.offer(Task(id="v", kind="visit", place=FAR))
    run.run(2.0)
    assert run.withdraw("v").accepted
    run.run(1.5)
    here = run.pose()
    run.run(2.0)
    assert run.pose() == here
    assert run.status().state is TaskState.CANCELLED
    assert run.call("visit", "doing") == ""
    assert run.finish(Task(id="again", kind="visit", place=FAR)).state is TaskState.DONE


@pytest.mark.parametrize("lasts_s", [0.0, 2.0])
def test_a_halt_ends_the_task_and_afterwards_another_can_be_taken_on(errands, lasts_s):
    run = errands("visit")
    run.offer(Task(id="v", kind="visit", place=FAR))
    run.run(2.0)
    halt = run.wire.publisher(HALT)
    halt.put(Halt(halted=True, by="test"))
    if lasts_s:  # else it ends before the next step
        run.run(1.0)
        here = run.pose()
        run.run(lasts_s)
        assert run.pose() == here
    halt.put(Halt(halted=False, by="test"))
    run.run(1.0)
    assert (run.status().state, run.status().why) == (TaskState.CANCELLED, "the robot is halted")
    here = run.pose()
    run.run(1.0)
    assert run.pose() == here
    assert run.finish(Task(id="again", kind="visit", place=FAR)).state is TaskState.DONE


@pytest.mark.slow
def test_a_task_whose_deadline_passes_has_failed(errands):
    run = errands("visit")
    assert run.offer(Task(id="v", kind="visit", place=FAR, deadline_ns=run.clock.now_ns() + 12_000_000_000)).accepted
    for _ in range(22):
        run.run(0.5)
        run.call("driver", "stop")  # somebody holds it up
    assert run.status().state is TaskState.RUNNING
    run.run(2.0)
    assert (run.status().state, run.status().why) == (TaskState.FAILED, "the deadline has passed")


def test_a_deadline_that_cannot_be_kept_is_refused_with_the_seconds(errands):
    run = errands("visit")
    answer = run.offer(
        Task(id="v", kind="visit", place=FAR, service_s=30.0, deadline_ns=run.clock.now_ns() + 20_000_000_000)
    )
    assert not answer.accepted
    assert answer.reason == Plain("needs_time", remaining_s=20.0)
    assert 34.0 < answer.reason.values["needed_s"] < 45.0


# -- energy ---------------------------------------------------------------------------------------------------------


def test_a_task_that_would_not_leave_the_way_home_is_refused_with_the_joules(errands):
    run = errands("visit")
    usable(run, 300.0)
    answer = run.offer(Task(id="v", kind="visit", place=FAR, service_s=60.0))
    assert not answer.accepted
    needed_j = answer.reason.needed_j
    assert answer.reason == NeedsEnergy(needed_j, usable_j=300.0)
    assert needed_j > 300.0
    usable(run, needed_j + 1.0)
    assert run.offer(Task(id="v", kind="visit", place=FAR, service_s=60.0)).accepted


def test_the_way_home_counts_and_a_charger_nearby_makes_it_short(errands):
    needed_j = []
    for x_m in (0.8, 4.6):
        run = errands("visit", parameters={"home": {"chargers": [{"x_m": x_m, "y_m": 3.0}]}})
        usable(run, 1.0)
        needed_j.append(run.offer(Task(id="v", kind="visit", place=FAR)).reason.needed_j)
    assert needed_j[0] > needed_j[1] * 1.3


def test_a_task_that_turns_out_dearer_is_given_back_and_the_robot_is_sent_home(errands):
    run = errands("visit")
    asked: list[str] = []
    home = run.plugin("home")
    home.asked.notify = asked.append
    assert run.offer(Task(id="v", kind="visit", place=FAR, service_s=60.0)).accepted
    run.run(4.0)
    usable(run, 200.0)
    run.run(2.5)
    assert (run.status().state, run.status().reason.usable_j) == (TaskState.CANCELLED, 200.0)
    assert asked == [f"v {run.status().why}"]
    here = run.pose()
    run.run(2.0)
    assert run.pose().distance_m(here) < 0.05


# -- one drives at a time -------------------------------------------------------------------------------------------


def test_a_visit_takes_the_place_of_exploring_and_the_other_way_round(errands):
    run = errands("visit", "explore")
    assert run.offer(Task(id="x", kind="explore", place=UNSEEN)).accepted
    run.run(0.5)
    assert run.offer(Task(id="v", kind="visit", place=FAR)).accepted
    run.run(1.0)
    assert run.call("explore", "goal") is None
    assert behavior(run) == "visit"
    before_m = run.path_m()
    run.run(1.0)
    assert run.path_m() > before_m + 0.1
    assert run.offer(Task(id="x2", kind="explore", place=UNSEEN)).accepted
    assert run.call("visit", "doing") == ""
    run.run(0.5)
    assert run.status().id == "x2"


NEAR, THERE = Point2D(2.5, 1.5), Point2D(3.2, 1.0)


class Wheels:
    """When the wheels were told to turn, and when to stand."""

    def __init__(self, run: Errands) -> None:
        self.told: list[tuple[int, bool]] = []
        moc = run.plugin("mocdevice")
        drive, stop = moc.drive, moc.stop

        def told_to_drive(twist: Twist2D) -> None:
            if twist != Twist2D():
                self.told.append((run.clock.now_ns(), True))
            drive(twist)

        def told_to_stop() -> None:
            self.told.append((run.clock.now_ns(), False))
            stop()

        moc.drive, moc.stop = told_to_drive, told_to_stop

    def idle_s(self) -> list[float]:
        """How long the wheels stood each time between two ways."""
        found, stopped_ns, turned = [], None, False
        for now_ns, turns in self.told:
            if turns and stopped_ns is not None and turned:
                found.append(to_seconds(now_ns - stopped_ns))
            turned |= turns
            stopped_ns = None if turns else (stopped_ns if stopped_ns is not None else now_ns)
        return found


def until_ended(run: Errands, task: str) -> None:
    for _ in range(3000):
        status = run.status()
        if status.id == task and status.state.ended:
            return
        run.run(0.02)
    raise AssertionError(f"{task} has not ended")


def test_the_wheels_are_told_of_the_next_task_in_the_step_in_which_they_stop(errands):
    run = errands("visit")
    wheels = Wheels(run)
    assert run.offer(Task(id="a", kind="visit", place=NEAR)).accepted
    run.run(0.5)
    assert run.offer(Task(id="b", kind="visit", place=THERE), after="a").accepted
    until_ended(run, "b")
    assert run.status().state is TaskState.DONE
    assert wheels.idle_s() == [0.0]


def test_a_next_task_that_cannot_be_reached_is_given_back_with_why(errands):
    run = errands("visit")
    run.offer(Task(id="a", kind="visit", place=NEAR))
    run.offer(Task(id="b", kind="visit", place=Point2D(-3.0, 1.0)), after="a")
    until_ended(run, "b")
    assert (run.status().state, run.status().why) == (TaskState.CANCELLED, "no way there")
    before = run.robot().desk.facts.before
    assert before is not None
    assert (before.id, before.state) == ("a", TaskState.DONE)
    run.run(1.0)
    assert run.robot().board.behavior == "idle"
