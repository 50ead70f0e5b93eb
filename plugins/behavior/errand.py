"""Errand: the common part of all behaviors that do one kind of task at a place.

A behavior defines the kind, its parameters, the work at the place and its cost. The errand accepts or refuses offers,
goes there, monitors energy and deadline, and reports the result:

class Mow(TaskParameters, frozen=True):
    width_m: Length

class MowBehavior(Errand[Mow]):
    kind = "mow"

    def work(self, task, mow):
        return Work(path_m=4 * mow.width_m)

    def do(self, task, mow):
        yield from self.go(Point2D(task.place.x_m + mow.width_m, task.place.y_m))
        return {}

`do` is a script: each `yield` ends a step. The return value is the task's result, and `raise Failed(why)` ends the task
as failed. The same script runs in both drives, for it never waits by itself.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator
from typing import Any, ClassVar, Generic, TypeVar, cast, get_args, get_origin

import msgspec

from robrain.agent.event import Event
from robrain.agent.plugin import Behavior, external
from robrain.plugins.behavior.budget import Budget, length_m
from robrain.plugins.behavior.travel import TROUBLE, Travel, TravelParameters, TravelState
from robrain.plugins.skill.energy import Work
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.errors import CallError
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.model.geometry import Point2D, wrap_angle_rad
from robrain.protocol.model.tasks.stock_kinds import TaskParameters
from robrain.protocol.model.tasks.task import BadParameters, Task, TaskState, parameters_of
from robrain.protocol.reasons import (
    Interruption,
    NeedsEnergy,
    OfferRefusal,
    PlainReason,
    Shut,
    needs_time,
    no_path,
    plain,
)

STEP_S = 0.25
MEASURED_S = 300.0
"""No two measurements of a task's energy are farther apart, also if the process was paused; otherwise the clock was
set."""
CHECK_NS = to_ns(2.0)
"""Period of the energy checks of a running task."""
SETTLE_S = 4.0
"""Longest time that an arrived robot rolls on to the very end of its path."""
ACTION_LIMIT_S = 20.0
FACED_RAD = 0.05

P = TypeVar("P", bound=TaskParameters)
Script = Generator[None, None, dict[str, Any]]
Part = Generator[None, None, None]
"""A piece of a script, for `yield from`."""

UNEXPLORED = plain("unexplored", "no way there, as its place is not explored yet")
IN_ZONE = plain("in_zone", "its place is in a zone where the robot must not stop")
AWAY_M = 0.3
"""A task that is done farther from its place says so (chosen: a robot's radius, and more than it stops short)."""
TURNS = 3
"""Number of turns, because the robot's estimated yaw may be corrected while it turns."""
REPORTED_PATH_M = 1.0
"""Shorter paths show nothing about the cost of paths."""


class Failed(Exception):
    """A script cannot do its work; the text is the reason. With a `Shut` reason the task does not count as tried."""


class Run(msgspec.Struct, Generic[P]):
    """A task that was accepted, and how far it is."""

    task: Task
    parameters: P
    """The task's, as its kind has them."""
    play: Callable[[], Script]
    """Makes its script, from the beginning."""
    goal: Point2D
    """Its place."""
    path_m: float
    """Planned length of the path there."""
    home_m: float
    """From the place to the nearest charger."""
    delay_s: float = 0.0
    """Time that doors and speed limits add to the planned path there."""
    own: str = ""
    """The robot's own activity, without a task of the task desk."""
    script: Any = None
    """The running script, as `play` makes it."""
    is_paused: bool = False
    """The robot is lost; its script starts again when the robot is localised."""
    is_as_planned: bool = True
    gone_m: float = 0.0
    at: Point2D | None = None
    has_begun: bool = False
    there_ns: int | None = None
    """When it was at the place."""
    there_gone_m: float = 0.0
    """Path length up to then."""
    away_m: float = 0.0
    """How far from the place it was then."""
    check_ns: int = 0
    energy_j: float = 0.0
    measured_ns: int = 0

    def __post_init__(self) -> None:
        self.script = self.play()

    def pause(self) -> None:
        """Pause the script."""
        self.is_paused = True
        self.is_as_planned = False
        self.script.close()

    def restart(self) -> None:
        """Start again, the path included: the robot may have gone somewhere else meanwhile."""
        self.is_paused = False
        self.there_ns = None
        self.script = self.play()


class Errand(Behavior, ABC, Generic[P]):
    """Does tasks of one kind, one at a time; derive from it, as in `Errand[Mow]` for the tasks' parameters."""

    Parameters: ClassVar[type[msgspec.Struct]] = TravelParameters
    period_s: float | None = STEP_S
    idle_period_s: ClassVar[float | None] = None
    """Its period while it is idle."""
    accepted = Event[str]()
    """Observed by the errand itself: the path begins in its own step, right after the answer to the offer."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for base in cls.__dict__.get("__orig_bases__", ()):
            if get_origin(base) is Errand and isinstance(get_args(base)[0], type):
                cls.task_parameters = get_args(base)[0]

    @abstractmethod
    def do(self, task: Task, parameters: P) -> Script:
        """Script of the task at its place; see the module."""

    def work(self, task: Task, parameters: P) -> Work:
        """Cost of `do`, by the task's service time and parameters alone, because it is used for other robots too.

        The coordinator asks for it as well. While the task runs, past waiting is subtracted.
        """
        return Work(wait_s=task.service_s)

    def left_s(self, run: Run[P]) -> float | None:
        """Estimate of a task's remaining time; None if it is unknown."""
        return self.budget.energy.estimate(self._left(run)).duration_s + self.travel.wait_s

    def go(self, goal: Point2D) -> Part:
        """Go to a place, arena frame, and stop there."""
        priority = 0.0 if self.run is None else self.run.task.priority
        if not self.travel.set_out(goal, priority=priority):
            raise Failed(self.travel.shut_before(goal) or TROUBLE[TravelState.NO_PATH])
        while (progress := self.travel.step()) is not TravelState.ARRIVED:
            if progress is TravelState.SHUT:
                raise Failed(self.travel.shut)
            if progress in TROUBLE:
                raise Failed(TROUBLE[progress])
            yield
        yield from self.settle()

    def settle(self) -> Part:
        """Let an arrived robot roll on to the very end of its path, and stop."""
        until_ns = self._now_ns() + to_ns(SETTLE_S)
        while self.travel.driver.motion() is Motion.DRIVING and self._now_ns() < until_ns:
            yield
        self.travel.stop()

    def wait(self, seconds: float) -> Part:
        """Stand for this time."""
        until_ns = self._now_ns() + to_ns(seconds)
        while self._now_ns() < until_ns:
            yield

    def face(self, yaw_rad: float) -> Part:
        """Turn on the spot until the robot has this heading, arena frame."""
        for _ in range(TURNS):
            turn_rad = wrap_angle_rad(yaw_rad - self.travel.pose().yaw_rad)
            if abs(turn_rad) < FACED_RAD:
                return
            self.travel.driver.turn(turn_rad)
            yield from self.arrive("the robot does not turn")

    def arrive(self, trouble: str) -> Part:
        """Let the driver finish its action; Failed if it takes too long."""
        until_ns = self._now_ns() + to_ns(ACTION_LIMIT_S)
        yield
        while self.travel.driver.motion() is not Motion.STOPPED:
            if self._now_ns() > until_ns:
                self.travel.stop()
                raise Failed(trouble)
            yield

    def away_m(self, place: Point2D) -> float:
        """Distance of the robot from a place."""
        return self.travel.pose().distance_m(place)

    def battery(self) -> BatteryState:
        """State of the battery; raises Failed if the battery reports none."""
        battery = self.env.board.battery
        if battery is None:
            raise Failed("the battery says nothing")
        return battery

    def init(self) -> None:
        self.travel = Travel(self.env, self.parameters)
        self.budget = Budget(self.env, self.travel)
        self.run: Run[P] | None = None

    def activate(self) -> None:
        self.period_s = STEP_S
        self.travel.connect()
        self.budget.connect()
        self.env.observe(self.accepted, lambda _task_id: self.step())
        self.env.observe(self.travel.driver.arrived, lambda _end: self._go_on())
        self.env.observe(self.travel.driver.finished, lambda _end: self._go_on())
        self.env.do_tasks(self.accept, self._let_go, self._work_of)

    def deactivate(self) -> None:
        self._let_go("deactivated")

    def emergency_halt(self) -> None:
        self.run = None
        self.travel.forget()

    @external
    def doing(self) -> str:
        """Id of the current task; empty if there is none of this kind."""
        run = self.run
        return "" if run is None else str(run.task.id)

    def step(self) -> None:
        run = self.run
        if run is None:
            self.period_s = self.idle_period_s  # None: in live its thread sleeps, in lockstep no step is called
            return
        if run.own and run.has_begun and not self.may_drive(run):  # a task has come: the wheels are its own
            self.drop()
            self.travel.forget()
            return
        if not run.has_begun:
            if not self.may_drive(run):
                return
            self._begin(run)
        self._measure(run)
        reason = self._stop_reason(run)
        if reason:
            self.finish(TaskState.CANCELLED if isinstance(reason, NeedsEnergy) else TaskState.FAILED, reason)
            return
        if self._is_lost(run):
            return
        try:
            next(run.script)
            self._foresee(run)
        except StopIteration as end:
            self.finish(TaskState.DONE, "", end.value)
        except Failed as failed:
            shut = failed.args[0] if isinstance(failed.args[0], Shut) else None
            self.finish(TaskState.CANCELLED if shut else TaskState.FAILED, shut or str(failed))
        except CallError as error:  # a device that a script asked gives no answer
            self.finish(TaskState.FAILED, error.message)

    def _foresee(self, run: Run[P]) -> None:
        """Report the expected end, so that the next task can be there when this one ends."""
        if run.own or run is not self.run:
            return
        left_s = self.left_s(run)
        self.env.tasks.foresee(run.task.id, None if left_s is None else self._now_ns() + to_ns(left_s))

    def _go_on(self) -> None:
        """The wheels have stopped: the next step does not wait for the period."""
        if self.run is not None and self.run.has_begun:
            self.env.hurry()

    def _is_lost(self, run: Run[P]) -> bool:
        """Whether the robot is lost; it then searches for its place, unless it stands at a charger."""
        battery = self.env.board.battery
        if not self.travel.lost or (battery is not None and battery.charging):
            if run.is_paused:
                self.travel.stop()
                run.restart()
            return False
        if not run.is_paused:
            run.pause()
        if not self.travel.find_itself(for_task=True):
            self.finish(TaskState.FAILED, self.travel.lost)
        return True

    def accept(self, task: Task) -> TaskAnswer:
        """Accept a task, or return the reason for a refusal; the path begins in the errand's own step."""
        try:
            parameters = cast(P, parameters_of(task, self.task_parameters))
        except BadParameters as error:
            return TaskAnswer.refused(PlainReason(str(error)))
        if (lost := self.travel.position_lost) is not None:
            return TaskAnswer.refused(lost)
        goal, further = task.place, parameters.further_places
        for place in (goal, *further):
            if not self.travel.may_stay(place):
                return TaskAnswer.refused(self.travel.shut_before(place) or IN_ZONE)
        path = self.travel.plan(goal)
        if path is None:
            return TaskAnswer.refused(self._no_path_to(goal))
        for place in further:
            if self.budget.path(goal, place) is None:
                return TaskAnswer.refused(self._no_path_to(place))
        path_m = length_m([self.travel.place(), *path])
        _, home_m = self.budget.path_home(path[-1] if path else goal)
        delay_s = self.travel.doors_s(path) + self.travel.delay_s(self._pace_m_s(), path)
        run = Run(task, parameters, lambda: self.play(task, parameters), goal, path_m, home_m, delay_s)
        reason = self.refusal(run)
        if reason is not None:
            return TaskAnswer.refused(reason)
        self.drop()
        self.accept_task(run)
        return TaskAnswer(accepted=True)

    def _no_path_to(self, place: Point2D) -> OfferRefusal:
        blocked = UNEXPLORED if self.travel.view().is_unexplored(place) else no_path()
        return self.travel.shut_before(place) or blocked

    def refusal(self, run: Run[P]) -> OfferRefusal | None:
        """Reason why a task cannot be accepted, before it is begun; None if it can."""
        verdict = self.budget.judge(self._left(run), run.home_m)
        if not verdict.is_affordable:
            return verdict.reason
        deadline_ns = run.task.deadline_ns
        if deadline_ns is not None and self._now_ns() + to_ns(verdict.duration_s) > deadline_ns:
            return needs_time(verdict.duration_s, to_seconds(deadline_ns - self._now_ns()))
        return None

    def ended_own(self, state: TaskState, reason: str) -> None:
        """Handle the end of an activity that the robot began by itself."""

    def accept_task(self, run: Run[P]) -> None:
        """Begin this task."""
        self.run = run
        self.period_s = STEP_S
        self.accepted.notify(run.task.id)

    def may_drive(self, run: Run[P]) -> bool:
        """Whether no other plugin moves the robot."""
        tasks = self.env.tasks
        return tasks.occupies(self.env.plugin) if run.own else tasks.may_begin(run.task.id)

    def _begin(self, run: Run[P]) -> None:
        run.has_begun = True
        run.check_ns = self._now_ns() + CHECK_NS
        run.measured_ns = self._now_ns()
        self.env.board.behavior = run.own or run.task.kind

    def play(self, task: Task, parameters: P) -> Script:
        """The whole of a task: the path there, the wait for its start, the work."""
        yield from self.go(task.place)
        self._report_outcome()
        while self._now_ns() < task.earliest_ns:
            yield
        if self.run is not None:
            self.run.there_ns, self.run.there_gone_m = self._now_ns(), self.run.gone_m
            self.run.away_m = self.away_m(task.place)
        return (yield from self.do(task, parameters))

    def _report_outcome(self) -> None:
        """The robot is there: learn from the cost of the path, if it went as planned."""
        run = self.run
        if run is not None and run.is_as_planned and run.path_m >= REPORTED_PATH_M:
            run.is_as_planned = False  # learn once from one path
            self.budget.energy.outcome(Work(path_m=run.path_m), run.energy_j)

    def finish(self, state: TaskState, reason: str | Interruption, result: dict[str, Any] | None = None) -> None:
        """The task has ended."""
        run = self.run
        self.drop()
        self.env.board.behavior = "idle"
        self.travel.stop()
        if run is not None and run.own:
            self.env.tasks.vacate(self.env.plugin)
            self.ended_own(state, str(reason))
        elif run is not None:
            if state is TaskState.DONE and run.away_m > AWAY_M:
                reason = f"{run.away_m:.2f} m from its place, which is not free"
            reported = {**(result or {}), "energy_j": round(run.energy_j, 1), "path_length_m": round(run.gone_m, 2)}
            self.env.tasks.end(run.task.id, state, reason, reported)

    def _let_go(self, _reason: str) -> None:
        if self.run is None:
            return
        self.drop()
        if self.env.tasks.is_busy:  # another behavior's task has taken the place of this one: the wheels are its own
            self.travel.forget()
        else:
            self.env.board.behavior = "idle"  # first: a plugin that it drives with may be gone
            self.travel.stop()

    def drop(self) -> None:
        """Drop the task; scripts clean up after themselves."""
        run, self.run = self.run, None
        if run is not None:
            run.script.close()

    def _measure(self, run: Run[P]) -> None:
        now_ns, pose = self._now_ns(), self.travel.pose()
        if run.at is not None:
            run.gone_m += pose.distance_m(run.at)
        run.at = Point2D(pose.x_m, pose.y_m)
        battery = self.env.board.battery
        elapsed_s = to_seconds(now_ns - run.measured_ns)
        if not 0.0 <= elapsed_s <= MEASURED_S:  # the clock was set: its cost is a guess, so nothing is learned
            run.is_as_planned, elapsed_s = False, STEP_S
        if battery is not None:
            run.energy_j += battery.voltage_v * battery.current_a * elapsed_s
        run.measured_ns = now_ns

    def _work_of(self, task: Task) -> Work:
        return self.work(task, cast(P, parameters_of(task, self.task_parameters)))

    def _left(self, run: Run[P]) -> Work:
        work = self.work(run.task, run.parameters)
        if run.there_ns is None:
            straight_m = 0.0 if run.at is None else run.at.distance_m(run.goal)
            delay_s = run.delay_s
            if run.at is not None:
                delay_s = self.travel.doors_left_s + self.travel.delay_s(self._pace_m_s())
            early_s = max(0.0, to_seconds(run.task.earliest_ns - self._now_ns()))
            return work + Work(path_m=max(straight_m, run.path_m - run.gone_m), wait_s=early_s + delay_s)
        stayed_s = to_seconds(self._now_ns() - run.there_ns)
        left_m = max(0.0, work.path_m - (run.gone_m - run.there_gone_m))
        return msgspec.structs.replace(work, path_m=left_m, wait_s=max(0.0, work.wait_s - stayed_s))

    def _pace_m_s(self) -> float:
        return 1.0 / self.budget.energy.estimate(Work(path_m=1.0)).duration_s

    def _stop_reason(self, run: Run[P]) -> str | NeedsEnergy | None:
        now_ns = self._now_ns()
        if run.task.deadline_ns is not None and now_ns > run.task.deadline_ns:
            return "the deadline has passed"
        if now_ns < run.check_ns:
            return None
        run.check_ns = now_ns + CHECK_NS
        return self.homing_reason(run)

    def homing_reason(self, run: Run[P]) -> NeedsEnergy | None:
        """Reason why a running task cannot continue, and the robot is sent home; None if it can."""
        verdict = self.budget.judge(self._left(run), run.home_m)
        if verdict.is_affordable:
            return None
        self.budget.home.ask(f"{run.task.id} {verdict.words}")
        return verdict.reason

    def _now_ns(self) -> int:
        return self.env.clock.now_ns()
