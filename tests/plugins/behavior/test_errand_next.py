"""One task after the other: the wheels do not wait for the next, and a robot says in how long it will be done."""

from collections.abc import Iterator

import pytest

from robrain.protocol.clock import to_seconds
from robrain.protocol.model.geometry import Point2D, Twist2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.table.topics import ROBOT_STATE
from tests.plugins.behavior.errands import Build, Errands, open_errands

NEAR, FAR = Point2D(2.5, 1.5), Point2D(3.2, 1.0)


@pytest.fixture
def errands() -> Iterator[Build]:
    yield from open_errands()


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

    def standing_s(self) -> list[float]:
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
    assert run.offer(Task(id="b", kind="visit", place=FAR), after="a").accepted
    until_ended(run, "b")
    assert run.status().state is TaskState.DONE
    assert wheels.standing_s() == [0.0]


def test_an_errand_goes_on_as_soon_as_the_wheels_stand(errands):
    """Its own step comes four times a second."""
    run = errands("visit")
    wheels = Wheels(run)
    run.offer(Task(id="a", kind="visit", place=NEAR))
    until_ended(run, "a")
    stopped_ns = next(now_ns for now_ns, turns in reversed(wheels.told) if not turns)
    assert to_seconds(run.clock.now_ns() - stopped_ns) <= 0.02


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


def test_a_robot_tells_in_how_long_it_will_be_done(errands):
    run = errands("visit")
    states = run.inbox(ROBOT_STATE, robot="r1")
    run.offer(Task(id="a", kind="visit", place=Point2D(5.0, 1.2), service_s=4.0))
    until_ended(run, "a")
    done_ns = run.clock.now_ns()
    told = [
        one.message
        for one in states.drain()
        if one.message.task is not None and one.message.task.remaining_s is not None
    ]
    assert len(told) > 50
    for state in told:
        remaining_s = to_seconds(done_ns - state.stamp_ns)
        within_s = 0.6 if remaining_s < 3.5 else 6.0  # at the place it is the clock's, on the way an estimate
        assert state.task.remaining_s == pytest.approx(remaining_s, abs=within_s)
