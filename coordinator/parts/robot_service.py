"""Takes robots out of service, and puts them back."""

from collections.abc import Sequence

import msgspec
from msgspec.structs import replace

from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.team.roster import Robot
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.service_messages import (
    COORDINATOR_HOLD_ROBOT,
    COORDINATOR_RELEASE_ROBOT,
    ServiceHold,
    ServiceRelease,
)
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import OutOfService, RobotOut
from robrain.protocol.wire.endpoint import Request, Serve


class HeldRobots(msgspec.Struct, frozen=True):
    """The robots that are out of service."""

    holds: dict[str, ServiceHold] = {}
    """How each was taken out of service, by its name; without a place once it is there."""


class RobotService(CoordinatorPart):
    """Robots out of service: they get no tasks, finish or give back what they have, and drive to a place if asked.

    Args:
        core: the team.

    """

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self._holds: dict[str, ServiceHold] = {}
        self._driving: dict[str, str] = {}
        """The task with which each robot drives to its place."""
        self._set(self.stored(HeldRobots).holds)
        core.wire.answer(COORDINATOR_HOLD_ROBOT, self._hold, serve=Serve.IN_STEP)
        core.wire.answer(COORDINATOR_RELEASE_ROBOT, self._release, serve=Serve.IN_STEP)

    def assign(self, robots: Sequence[Robot], now_ns: int) -> None:
        """Send robots that have no task to their places, and forget retired ones that have left."""
        for name, hold in self._holds.items():
            robot = self.core.roster.robots.get(name)
            if robot is None or self.core.tasks.bound_to(name):
                continue
            if hold.retires and not robot.has_token:
                self.core.roster.remove(robot)
            elif hold.place is not None and self._may_drive(robot, now_ns):
                self._driving[name] = self.core.new_id(VISIT)
                self.core.offer_own(Task(id=self._driving[name], kind=VISIT, place=hold.place), name, now_ns)

    def _may_drive(self, robot: Robot, now_ns: int) -> bool:
        is_able = robot.is_up(now_ns) and robot.state is not None and not robot.state.halted
        return is_able and self.core.lifecycle.backoff.robots.pause_reason(robot.name, now_ns) is None

    def task_ended(self, record: TaskRecord, robot: str, status: TaskStatus, now_ns: int) -> None:
        """A robot may have reached its place."""
        if self._driving.get(robot) == record.task.id and status.state is TaskState.DONE and robot in self._holds:
            self._store(self._holds | {robot: replace(self._holds[robot], place=None)})

    def _hold(self, request: Request[ServiceHold]) -> None:
        hold, name = replace(request.asked, by=request.asked.by or request.by), request.asked.robot
        if name not in self.core.roster.robots:
            known = ", ".join(sorted(self.core.roster.robots)) or "none"
            raise CallError(ErrorCode.REFUSED, f"{name} is not held: no such robot is known; there are: {known}")
        self._change(name, self._holds | {name: hold})
        with self.core.lifecycle.as_far_as_written(self.core.wire.clock.now_ns()):
            for record in self.core.tasks.bound_to(name):
                out = RobotOut(name, _reason(hold))
                if record.own:
                    self.core.tasks.give_back(record.task.id, out)
                elif hold.gives_back or record.state is TaskState.OFFERED:
                    self.core.tasks.update(record.task, out, recalls=True)

    def _release(self, request: Request[ServiceRelease]) -> None:
        name = request.asked.robot
        if name not in self._holds:
            held = ", ".join(sorted(self._holds)) or "none"
            raise CallError(ErrorCode.REFUSED, f"{name} is in service; robots out of service: {held}")
        self._change(name, {other: hold for other, hold in self._holds.items() if other != name})

    def _change(self, name: str, holds: dict[str, ServiceHold]) -> None:
        try:
            self._store(holds)
        except JournalUnwritable as error:
            raise CallError(ErrorCode.REFUSED, f"{name} is left as it is: {error}") from error
        self._driving.pop(name, None)
        self.core.assign_soon()
        self.core.report_soon()

    def _store(self, holds: dict[str, ServiceHold]) -> None:
        self.store(HeldRobots(holds=holds))
        self._set(holds)

    def _set(self, holds: dict[str, ServiceHold]) -> None:
        self._holds = holds
        self.core.roster.set_out_of_service({name: _reason(hold) for name, hold in holds.items()})


def _reason(hold: ServiceHold) -> OutOfService:
    return OutOfService(by=hold.by, why=hold.reason, paused=hold.pauses)
