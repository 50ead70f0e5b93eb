"""Takes robots out of service, puts them back, and renames them."""

from collections.abc import Mapping, Sequence

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
    COORDINATOR_RENAME_ROBOT,
    RobotLabel,
    RobotRename,
    ServiceHold,
    ServiceRelease,
)
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import OutOfService, RobotOut
from robrain.protocol.wire.endpoint import Request, Serve


class HeldRobots(msgspec.Struct, frozen=True):
    """The robots that are out of service, and the renamed ones."""

    holds: dict[str, ServiceHold] = {}
    """How each was taken out of service, by its name; without a place once it is there."""
    labels: dict[str, RobotLabel] = {}
    """Of renamed robots, by their names."""


class RobotService(CoordinatorPart):
    """Robots out of service: they get no tasks, finish or give back what they have, and drive to a place if asked.

    Requests name a robot by its name or its label.

    Args:
        core: the team.

    """

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self._holds: dict[str, ServiceHold] = {}
        self._driving: dict[str, str] = {}
        """The task with which each robot drives to its place."""
        self._set(self.stored(HeldRobots))
        core.wire.answer(COORDINATOR_HOLD_ROBOT, self._hold, serve=Serve.IN_STEP)
        core.wire.answer(COORDINATOR_RELEASE_ROBOT, self._release, serve=Serve.IN_STEP)
        core.wire.answer(COORDINATOR_RENAME_ROBOT, self._rename, serve=Serve.IN_STEP)

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
            self._store(self._holds | {robot: replace(self._holds[robot], place=None)}, self.core.roster.labels)

    def _hold(self, request: Request[ServiceHold]) -> None:
        name = self._known(request.asked.robot, "held")
        hold = replace(request.asked, robot=name, by=request.asked.by or request.by)
        self._change(name, self._holds | {name: hold}, self.core.roster.labels)
        with self.core.lifecycle.as_far_as_written(self.core.wire.clock.now_ns()):
            for record in self.core.tasks.bound_to(name):
                out = RobotOut(name, _reason(hold))
                if record.own:
                    self.core.tasks.give_back(record.task.id, out)
                elif hold.gives_back or record.state is TaskState.OFFERED:
                    self.core.tasks.update(record.task, out, recalls=True)

    def _release(self, request: Request[ServiceRelease]) -> None:
        name = self._name_of(request.asked.robot)
        if name not in self._holds:
            held = ", ".join(sorted(self._holds)) or "none"
            raise CallError(ErrorCode.REFUSED, f"{name} is in service; robots out of service: {held}")
        holds = {other: hold for other, hold in self._holds.items() if other != name}
        self._change(name, holds, self.core.roster.labels)

    def _rename(self, request: Request[RobotRename]) -> None:
        name, label = self._known(request.asked.robot, "renamed"), request.asked.label
        labels = {other: kept for other, kept in self.core.roster.labels.items() if other != name}
        owner = next((other for other, kept in labels.items() if kept.text == label), label)
        if owner != name and owner in self.core.roster.robots:
            raise CallError(ErrorCode.REFUSED, f"{name} is not renamed: {label} names {owner}")
        if label:
            labels[name] = RobotLabel(label, request.asked.by or request.by)
        self._change(name, self._holds, labels)

    def _name_of(self, name: str) -> str:
        """The name of the robot with a label; else what was given."""
        return next((robot for robot, label in self.core.roster.labels.items() if label.text == name), name)

    def _known(self, given: str, verb: str) -> str:
        name = self._name_of(given)
        if name not in self.core.roster.robots:
            known = ", ".join(sorted(self.core.roster.robots)) or "none"
            raise CallError(ErrorCode.REFUSED, f"{given} is not {verb}: no such robot is known; there are: {known}")
        return name

    def _change(self, name: str, holds: dict[str, ServiceHold], labels: Mapping[str, RobotLabel]) -> None:
        try:
            self._store(holds, labels)
        except JournalUnwritable as error:
            raise CallError(ErrorCode.REFUSED, f"{name} is left as it is: {error}") from error
        self._driving.pop(name, None)
        self.core.assign_soon()
        self.core.report_soon()

    def _store(self, holds: dict[str, ServiceHold], labels: Mapping[str, RobotLabel]) -> None:
        changed = HeldRobots(holds=holds, labels=dict(labels))
        self.store(changed)
        self._set(changed)

    def _set(self, stored: HeldRobots) -> None:
        self._holds, self.core.roster.labels = stored.holds, stored.labels
        self.core.roster.set_out_of_service({name: _reason(hold) for name, hold in stored.holds.items()})


def _reason(hold: ServiceHold) -> OutOfService:
    return OutOfService(by=hold.by, why=hold.reason, paused=hold.pauses)
