"""Errand of a point: what the behaviors of a stand-in robot have in common; the light counterpart of `Errand`."""

from typing import ClassVar

from robrain.agent.plugin import Behavior
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import NeedsEnergy, OfferRefusal, needs_time
from robrain.sim.stand_in.plugins.point_base.interface import PointBaseInterface
from robrain.sim.stand_in.point_body import drive_j, drive_s

STEP_S = 0.1
RESERVE_J = 200.0
THERE_M = 0.05


class PointErrand(Behavior):
    """Goes to a task's place and stays for its service time."""

    period_s: float | None = STEP_S
    idle_period_s: ClassVar[float | None] = None
    """Its period while it has nothing to do."""

    def init(self) -> None:
        self.task: Task | None = None
        self._present_ns: int | None = None

    def activate(self) -> None:
        self.base = self.env.use("point_base", PointBaseInterface)
        self.env.do_tasks(self.accept, self.let_go, self.work)

    def work(self, task: Task) -> Work:
        """What a task takes at its place."""
        return Work(wait_s=task.service_s)

    def accept(self, task: Task) -> TaskAnswer:
        """Take a task on, or say why not."""
        reason = self.why_not(task)
        if reason is not None:
            return TaskAnswer.refused(reason)
        self.accept_task(task)
        return TaskAnswer(accepted=True)

    def accept_task(self, task: Task) -> None:
        """Have this to do from now on."""
        self.task, self._present_ns, self.period_s = task, None, STEP_S

    def let_go(self, why: str) -> None:
        """Drop what it does."""
        self.drop()

    def drop(self) -> None:
        """Do nothing any more."""
        self.task = None
        self.env.board.behavior = ""

    def deactivate(self) -> None:
        self.drop()

    def emergency_halt(self) -> None:
        self.task = None

    def why_not(self, task: Task) -> OfferRefusal | None:
        """Why a task cannot be taken on; None if it can."""
        way_m = self.base.place().distance_m(task.place)
        charger = self.base.nearest_charger()
        home_m = 0.0 if charger is None else task.place.distance_m(charger)
        needed_j = drive_j(way_m + home_m, task.service_s) + RESERVE_J
        if needed_j > self.base.energy_j():
            return NeedsEnergy(round(needed_j, 3), round(self.base.energy_j(), 3))
        now_ns = self.env.clock.now_ns()
        takes_s = drive_s(way_m) + task.service_s
        if task.deadline_ns is not None and now_ns + to_ns(takes_s) > task.deadline_ns:
            return needs_time(takes_s, to_seconds(task.deadline_ns - now_ns))
        return None

    def step(self) -> None:
        task = self.task
        if task is None:
            self.period_s = self.idle_period_s
            return
        if not self.may_drive(task):
            return
        self.env.board.behavior = self.env.plugin.removeprefix("point_")
        now_ns = self.env.clock.now_ns()
        way_m = self.base.place().distance_m(task.place)
        if way_m > THERE_M:
            self.base.go(task.place, task.id)
            self._foresee(task, drive_s(way_m) + task.service_s)
            return
        if self._present_ns is None:
            self._present_ns = now_ns
        self.base.stay(task.id)
        served_s = to_seconds(now_ns - self._present_ns)
        self._foresee(task, task.service_s - served_s)
        if self.is_done(task, served_s):
            self.finish(task)

    def may_drive(self, task: Task) -> bool:
        """Whether nobody else moves the robot."""
        return self.env.tasks.may_begin(task.id)

    def is_done(self, task: Task, served_s: float) -> bool:
        """Whether a task that the robot is at, since so long, is done."""
        return served_s >= task.service_s and now_or_later(task, self.env.clock.now_ns())

    def finish(self, task: Task) -> None:
        """The task is done."""
        self.drop()
        self.base.stand()
        self.env.tasks.end(task.id, TaskState.DONE)

    def _foresee(self, task: Task, left_s: float) -> None:
        self.env.tasks.foresee(task.id, self.env.clock.now_ns() + to_ns(max(0.0, left_s)))


def now_or_later(task: Task, now_ns: int) -> bool:
    """Whether a task may have begun by now."""
    return now_ns >= task.earliest_ns


def home_j(place: Point2D, charger: Point2D | None) -> float:
    """Energy of the way home, and the reserve."""
    return RESERVE_J + (0.0 if charger is None else drive_j(place.distance_m(charger)))
