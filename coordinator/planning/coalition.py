"""Tasks for several robots at once: the robots gather around the place, and start when all are there.

Such a task is `running` from the time its robots set out, with no robot in its record. The work of its robots are
*parts*: tasks of the coordinator's own, submitted (`by`) by the task. Each robot first drives to its spot; then all get
the task at once. The task is done when all these parts are. If one fails, the others are cancelled and the task is
queued again. Parts are in the journal like all tasks, so a restarted coordinator continues from them.
"""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np

from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.protocol.messages.tasks.task_messages import TaskFilter, TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.stock_kinds import EXPLORE, VISIT
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import Refused, RobotOut, RobotReason, TaskReason, needed_for, plain

if TYPE_CHECKING:  # brings the map's kernels, which a coordinator loads when it is up (coordinator/live.py)
    from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid

PARTS_MAX = 1000
GATHER, SHARE = "gather", "share"
"""Prefixes of the ids of parts."""

ROOM_M = 0.3
"""Gap between the edges of two robots at their spots (chosen: closer robots yield to each other)."""
DIRECTIONS = 24


class _Group(NamedTuple):
    """The robots of a task, and their progress."""

    robots: tuple[str, ...]
    spots: tuple[Point2D, ...]
    gathering: tuple[str, ...]
    """Ids of the gathering parts, in the order of the robots."""
    doing: tuple[str, ...] = ()
    """Ids of the parts that do the task; empty while the robots gather."""


class Coalitions:
    """Executes tasks for several robots.

    Args:
        planning: decides which robots, and when.
        lifecycle: offers the parts.
        new_id: makes an unused task id of a kind.

    """

    def __init__(self, planning: Planning, lifecycle: TaskLifecycle, new_id: Callable[[str], str]) -> None:
        self._planning, self._lifecycle = planning, lifecycle
        self._book, self._map, self._new_id = lifecycle.book, lifecycle.team_map, new_id
        self._groups: dict[str, _Group] = {}
        for record in self._book.open:
            if record.task.robots > 1 and not record.own and record.state is not TaskState.QUEUED:
                self._groups[record.task.id] = self._remembered(record)
        self._hold()

    def step(self, now_ns: int) -> None:
        """Start tasks that can start, and advance those that run."""
        if not self._groups and not self._planning.has_teamwork:
            return
        with self._lifecycle.as_far_as_written(now_ns):
            for task_id in list(self._groups):
                self._advance(task_id, now_ns)
            for task_id, robots in self._planning.due_together(now_ns):
                self._begin(task_id, robots, now_ns)
        self._hold()

    # -- one task -------------------------------------------------------------------------------------------

    def _begin(self, task_id: str, robots: Sequence[str], now_ns: int) -> None:
        record = self._book.find(task_id)
        if record is None:
            return
        for robot in robots:
            at = self._book.of_robot(robot)
            if at is not None and at.task.kind == EXPLORE:
                self._book.move(at.task.id, TaskState.CANCELLED, needed_for(robot, task_id))
        spots = self._spots(record.task, robots)
        gather = plain("gather", f"{' and '.join(robots)} gather for it", robots=tuple(robots))
        self._book.begin_together(task_id, gather)
        gathering = tuple(
            self._add(Task(id=self._new_id(GATHER), kind=VISIT, place=spot, priority=record.task.priority), task_id)
            for spot in spots
        )
        self._groups[task_id] = _Group(tuple(robots), tuple(spots), gathering)
        self._offer(task_id, robots, gathering, now_ns)

    def _advance(self, task_id: str, now_ns: int) -> None:
        group, record = self._groups[task_id], self._book.find(task_id)
        if record is None or record.state is not TaskState.RUNNING:  # it was cancelled, or is too late
            whole = None if record is None else plain("whole_is", f"{task_id} is {record.state}", state=record.state)
            self._call_off(task_id, whole)
            return
        if not group.robots:
            del self._groups[task_id]
            unoffered = plain("parts_untold", "the coordinator started again before all had been told")
            self._book.give_back(task_id, unoffered)
            return
        parts = [self._book.find(part) for part in group.doing or group.gathering]
        for robot, part in zip(group.robots, parts, strict=True):
            if part is None or (part.state.ended and part.state is not TaskState.DONE):
                has_failed = part is not None and part.state is TaskState.FAILED
                cause = part.why if part is not None else "nothing is known of it"
                text = f"{'failed at its part' if has_failed else 'does not do its part'}: {cut(cause)}"
                reason = plain("part_failed" if has_failed else "part_undone", text)
                self._fail(task_id, robot, reason, now_ns, failed=has_failed)
                return
        done = [part for part in parts if part is not None and part.state is TaskState.DONE]
        if len(done) < len(parts):
            return
        if group.doing:
            del self._groups[task_id]
            energy_j = sum(float(part.result.get("energy_j", 0.0)) for part in done)
            result = {"robots": list(group.robots), "energy_j": round(energy_j, 1)}
            self._book.move(task_id, TaskState.DONE, result=result)
            return
        if self._lifecycle.eligibility.offer_refusal() is not None:
            return  # another coordinator may be offering the same task; its robots wait
        doing = tuple(self._add(self._own_share(record.task, spot), task_id) for spot in group.spots)
        self._groups[task_id] = group._replace(doing=doing)
        self._offer(task_id, group.robots, doing, now_ns)

    def _offer(self, task_id: str, robots: Sequence[str], parts: Sequence[str], now_ns: int) -> None:
        for robot, part in zip(robots, parts, strict=True):
            refusal = self._lifecycle.offer(part, robot, now_ns)
            if refusal is not None:
                self._fail(task_id, robot, Refused(refusal), now_ns, failed=False)
                return

    def _fail(self, task_id: str, robot: str, reason: RobotReason, now_ns: int, *, failed: bool) -> None:
        """A robot does not do its part: free all its robots, and exclude this one from the task for a while."""
        self._lifecycle.backoff.record(task_id, robot, reason, now_ns)
        self._call_off(task_id, RobotOut(robot, reason))
        record = self._book.give_back(task_id, RobotOut(robot, reason), failed=failed)
        if not record.state.ended and (hopeless := self._lifecycle.eligibility.hopeless(record, now_ns)):
            self._book.move(task_id, TaskState.FAILED, hopeless)

    def _call_off(self, task_id: str, reason: TaskReason | None) -> None:
        group = self._groups.pop(task_id)
        for part in (*group.gathering, *group.doing):
            if self._book.is_open(part):
                self._book.move(part, TaskState.CANCELLED, reason)

    # -- parts ----------------------------------------------------------------------------------------------

    def _add(self, task: Task, task_id: str) -> str:
        return self._book.add(task, by=task_id, own=True).task.id

    def _own_share(self, task: Task, spot: Point2D) -> Task:
        return msgspec.structs.replace(task, id=self._new_id(SHARE), robots=1, after=(), earliest_ns=0, place=spot)

    def _spots(self, task: Task, robots: Sequence[str]) -> list[Point2D]:
        """Assign each robot, in order, the nearest spot that is left."""
        states = {name: self._lifecycle.roster.robots[name].state for name in robots}
        radius_m = max(state.radius_m for state in states.values() if state is not None)
        left = spots_around(task.place, len(robots), radius_m, self._map.grid)
        chosen = []
        for name in robots:
            state = states[name]
            pose = state.pose if state is not None else None
            spot = left[0] if pose is None else min(left, key=pose.distance_m)
            left.remove(spot)
            chosen.append(spot)
        return chosen

    def _remembered(self, record: TaskRecord) -> _Group:
        """Restore the robots of a task from the journal; parts of earlier attempts have all ended unfinished."""
        parts = self._book.journal.select(TaskFilter(by=record.task.id, own=True, limit=PARTS_MAX))
        count = record.task.robots
        gathers = [index for index, part in enumerate(parts) if part.task.id.startswith(GATHER)][-count:]
        gathering = [parts[index] for index in gathers]
        doing = parts[gathers[-1] + 1 :] if gathers else []
        if len(gathering) < count or len(doing) not in (0, count):
            return _Group((), (), ())  # the coordinator was killed between the offers
        return _Group(
            tuple(part.robot for part in gathering),
            tuple(part.task.place for part in gathering),
            tuple(part.task.id for part in gathering),
            tuple(part.task.id for part in doing),
        )

    def _hold(self) -> None:
        """Reserve robots that wait for the others."""
        held = {}
        for task_id, group in self._groups.items():
            for robot in group.robots:
                others = tuple(name for name in group.robots if name != robot)
                text = f"is at {task_id} with {' and '.join(others)}"
                held[robot] = plain("with_others", text, task=task_id, others=others)
        self._planning.held = held


def spots_around(place: Point2D, robots: int, radius_m: float, grid: "OccupancyGrid | None") -> list[Point2D]:
    """Return spots on a ring around a place, evenly spaced, turned so that most are on floor known to be free.

    Args:
        place: centre of the ring, arena frame.
        robots: number of spots.
        radius_m: of the largest robot.
        grid: the known map.

    Returns:
        One spot per robot; for one robot, the place itself.

    """
    if robots == 1:
        return [place]
    ring_m = (2.0 * radius_m + ROOM_M) / (2.0 * math.sin(math.pi / robots))
    turns = [math.tau * turn / DIRECTIONS / robots for turn in range(DIRECTIONS)]
    rings = [[_on_ring(place, ring_m, turn + math.tau * k / robots) for k in range(robots)] for turn in turns]
    return max(rings, key=lambda ring: sum(_is_free(spot, radius_m, grid) for spot in ring))


def _on_ring(place: Point2D, ring_m: float, angle_rad: float) -> Point2D:
    return Point2D(
        round(place.x_m + ring_m * math.cos(angle_rad), 3), round(place.y_m + ring_m * math.sin(angle_rad), 3)
    )  # fmt: skip


def _is_free(spot: Point2D, radius_m: float, grid: "OccupancyGrid | None") -> bool:
    if grid is None:
        return True
    row, column = grid.geometry.cell_of(spot.x_m, spot.y_m)
    reach = math.ceil(radius_m / grid.geometry.resolution_m)
    box = grid.log_odds[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1]
    return box.shape == (2 * reach + 1, 2 * reach + 1) and bool(np.all(box < 0))
