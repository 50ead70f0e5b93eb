"""Builds the snapshot for planning: open tasks, available robots, the map, the progress of running tasks.

`exclusion` returns why plans exclude a robot, `free_in_s` when a working robot can begin something else.
"""

import math
from collections.abc import Callable, Iterable, Mapping

from robrain.coordinator.planning.energy_budget import when_charged
from robrain.coordinator.planning.snapshot import AfterCharge, Floor, PlanningRobot, PredictedEnd, end_of
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.chargers import KnownChargers
from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import EXPLORE, RECHARGE
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons import RobotReason, halted, plain, position_unknown

AT_PLACE_M = 1.0
"""A robot this close to the place of its task counts as being there."""
SOON_FREE_NS = to_ns(1.0)
"""A robot that still charges is not free before this, despite any prediction."""
FLOOR_NS = to_ns(10.0)
"""Interval at which the map is read again; earlier if it has grown and that may help, or a robot was blocked."""

HOMEWARD = frozenset({"recharge", "go home"})
"""Behaviors, as robots report them, that a robot does not leave for a task if it began them on its own initiative."""
AHEAD_S = 3.0
"""A robot that ends its task within this is offered the next one. Chosen: long enough for a new plan and an offer on a
slow link. It is short, because the offer stands even if a later plan is better."""
LATEST_S = 1.0
"""Without a new plan by then, the next task of the old plan is offered (chosen)."""


class SnapshotBuilder:
    """Builds snapshots.

    Args:
        lifecycle: of the tasks, with the book and the robots.
        chargers: known to the robots.
        exclusion: why plans exclude a robot now; None if they do not.
        after_charge: predicted states of charging robots after their charge, from `Planning`.

    """

    def __init__(
        self,
        lifecycle: TaskLifecycle,
        chargers: KnownChargers,
        exclusion: Callable[[Robot, int], RobotReason | None],
        after_charge: Mapping[str, AfterCharge],
    ) -> None:
        self.is_blocked = False
        """Whether a robot was blocked since the map was read."""
        self._book, self._roster, self._capabilities = lifecycle.book, lifecycle.roster, lifecycle.capabilities
        self._map, self._chargers = lifecycle.team_map, chargers
        self._exclusion, self._after_charge = exclusion, after_charge
        self._present_ns: dict[str, int] = {}
        self._floor: Floor | None = None
        self._floor_ns = 0

    def records(self) -> list[TaskRecord]:
        """Open tasks that were submitted."""
        return [record for record in self._book.open if not record.own]

    def places(self, now_ns: int) -> dict[str, Point2D]:
        """Places of the robots that are present and localised."""
        return {name: _here(state) for name, state in self._up(now_ns).items()}

    def members(self, now_ns: int) -> dict[str, PlanningRobot]:
        """The robots that plans can use, now or after their charge."""
        members = {}
        for name, state in self._up(now_ns).items():
            free_ns = 0
            if self._exclusion(self._roster.robots[name], now_ns) is not None:
                after = self._after_charge.get(name)
                if after is None or not is_charging(self._roster.robots[name], self._book.of_robot(name)):
                    continue
                state, free_ns = when_charged(state, after), max(after.free_ns, now_ns + SOON_FREE_NS)
            members[name] = self._member(name, state, free_ns)
        return members

    def absent(self) -> dict[str, PlanningRobot]:
        """All robots with a known place, in their last received state, including those that plans cannot use."""
        states = {name: robot.state for name, robot in self._roster.robots.items()}
        return {
            name: self._member(name, one) for name, one in states.items() if one is not None and one.pose is not None
        }

    def _member(self, name: str, state: RobotState, free_ns: int = 0) -> PlanningRobot:
        return PlanningRobot(
            state=state,
            offers=self._capabilities.plugins.get(name),
            chargers=tuple(one.place for one in self._chargers.of.get(name, ())),
            home=self._chargers.home.get(name) or _here(state),
            free_ns=free_ns,
        )

    def done_before(self, records: Iterable[TaskRecord], open_ids: set[str]) -> frozenset[str]:
        """Tasks that these depend on and that are done."""
        names = {name for record in records for name in record.task.others} - open_ids
        found = (self._book.find(name) for name in names)
        return frozenset(one.task.id for one in found if one is not None and one.state is TaskState.DONE)

    def held(self, records: Iterable[TaskRecord]) -> frozenset[str]:
        """Tasks that robots will begin after their running one."""
        robots = {record.robot for record in records if record.robot}
        return frozenset(record.task.id for name in robots if (record := self._book.next_of(name)) is not None)

    def ending(
        self, members: Mapping[str, PlanningRobot], works: Mapping[str, Iterable[Work]]
    ) -> dict[str, PredictedEnd]:
        """Place and time of the end of running tasks that are about to end."""
        found = {}
        for name, member in members.items():
            at = self._book.of_robot(name)
            remaining_s = math.inf if at is None or at.own else left_of(at, member.state)
            if at is not None and remaining_s <= AHEAD_S:
                found[name] = PredictedEnd(at.task.id, end_of(at.task, works), remaining_s)
        return found

    def served_s(self, records: Iterable[TaskRecord], now_ns: int) -> dict[str, float]:
        """How long the robots of running tasks have been at their places; only of robots that are there."""
        there: dict[str, int] = {}
        for record in records:
            robot = self._roster.robots.get(record.robot)
            if robot is None or robot.state is None or robot.state.pose is None:
                continue
            if self._book.of_robot(record.robot) is not record:  # it begins that later
                continue
            if robot.state.pose.distance_m(record.task.place) <= AT_PLACE_M:
                there[record.task.id] = self._present_ns.get(record.task.id, now_ns)
        self._present_ns = there
        return {task: to_seconds(now_ns - since_ns) for task, since_ns in there.items()}

    def floor(self, now_ns: int, *, wanted: bool) -> Floor | None:
        """The map, usually as it was last read, because a new one means computing all path lengths again.

        Args:
            now_ns: the time.
            wanted: whether more map would help.

        """
        grid, floor = self._map.grid, self._floor
        if grid is None or (floor is not None and floor.version == grid.version):
            return floor
        is_old = now_ns - self._floor_ns > FLOOR_NS or (floor is not None and floor.zones != self._map.zones)
        if floor is None or is_old or self.is_blocked or wanted:
            self._floor = Floor(grid.classes(), grid.geometry, grid.version, self._map.zones)
            self._floor_ns = now_ns
            self.is_blocked = False
        return self._floor

    def _up(self, now_ns: int) -> dict[str, RobotState]:
        return {
            robot.name: robot.state
            for robot in self._roster.up(now_ns)
            if robot.state is not None and robot.state.pose is not None
        }


def _here(state: RobotState) -> Point2D:
    assert state.pose is not None
    return Point2D(state.pose.x_m, state.pose.y_m)


def exclusion(robot: Robot, at: TaskRecord | None, now_ns: int) -> RobotReason | None:
    """Why plans exclude a robot now; None if they do not.

    Args:
        robot: from the roster.
        at: the task that it is doing.
        now_ns: the time.

    """
    if (unavailable := robot.down_reason(now_ns) or robot.out_of_service) is not None:
        return unavailable
    state = robot.state
    if state is None or state.pose is None:
        return position_unknown()
    if state.halted:
        return halted()
    if at is not None and at.task.kind == RECHARGE:
        return plain("sent_to_charge", f"is to charge: {at.task.id}", task=at.task.id)
    is_busy = state.task is not None and not state.task.state.ended
    if state.behavior in HOMEWARD and not is_busy:
        is_charging = state.battery is not None and state.battery.charging
        return plain("charging", "charges") if is_charging else plain("heads_home", "goes home to charge")
    if at is None and state.lost:
        return position_unknown(state.lost)
    return None


def is_charging(robot: Robot, at: TaskRecord | None) -> bool:
    """Whether a robot is excluded only because it charges, or drives to a charger, and will be free afterwards."""
    state = robot.state
    if state is None or state.halted or state.lost:
        return False
    if at is not None:
        return at.task.kind == RECHARGE
    is_busy = state.task is not None and not state.task.state.ended
    return state.behavior in HOMEWARD and not is_busy


def free_in_s(robot: Robot, records: list[TaskRecord]) -> float:
    """Time until a robot can begin something else; infinite if it must not be offered anything yet.

    Args:
        robot: from the roster.
        records: its open tasks in the book, the one that it is doing first.

    """
    if not records:
        return 0.0
    at, state = records[0], robot.state
    if at.own:
        return 0.0 if at.task.kind == EXPLORE else math.inf
    if len(records) > 1 or state is None or state.next_task is not None:
        return math.inf
    remaining_s = left_of(at, state)
    return remaining_s if remaining_s <= AHEAD_S else math.inf


def left_of(at: TaskRecord, state: RobotState) -> float:
    """Time until a robot ends the task that the book has it doing, as the robot reports it; infinite if it does not."""
    status = state.task
    is_at_it = status is not None and (status.id, status.epoch) == (at.task.id, at.epoch) and not status.state.ended
    return status.remaining_s if is_at_it and status is not None and status.remaining_s is not None else math.inf


def is_ending(state: RobotState | None) -> bool:
    """Whether a robot reports that it is about to end its task."""
    remaining_s = state.task.remaining_s if state is not None and state.task is not None else None
    return remaining_s is not None and remaining_s <= AHEAD_S
