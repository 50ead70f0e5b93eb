"""Detects changes since the last plan that need a new one."""

from collections.abc import Iterable

from robrain.coordinator.planning.energy_budget import PLENTY_J, profile_of
from robrain.coordinator.planning.snapshot import Member
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.messages.tasks.task_messages import TaskRecord

DRAINED_SHARE = 0.02
"""A robot that has used this share of its full battery more than planned triggers a new plan."""
DEARER_SHARE = 0.05
"""A robot whose learned path costs have changed by this share triggers a new plan."""
GROWN_SHARE = 0.05
"""Growth of the map after which it is read again."""


class ReplanTrigger:
    """Compares the team with its state at the last plan."""

    def __init__(self) -> None:
        self._tasks: frozenset[tuple[str, TaskState, str]] = frozenset()
        self._members: dict[str, tuple[frozenset[str] | None, tuple[Point2D, ...], bool]] = {}
        self._figures: dict[str, tuple[float, float]] = {}
        self._pauses: frozenset[tuple[str, str]] = frozenset()
        self._area_m2 = 0.0

    @property
    def has_tasks(self) -> bool:
        """Whether there were tasks at the last plan."""
        return bool(self._tasks)

    def since(
        self,
        records: Iterable[TaskRecord],
        members: dict[str, Member],
        pauses: Iterable[tuple[str, str]],
        area_m2: float,
        *,
        left_out: int,
    ) -> str:
        """Why a new plan is needed; empty if it is not."""
        tasks = _tasks(records)
        if tasks != self._tasks:
            return _difference(tasks, self._tasks)
        if members.keys() != self._members.keys():
            came = sorted(members.keys() - self._members.keys())
            gone = sorted(self._members.keys() - members.keys())
            return "; ".join([*(f"{name} is there" for name in came), *(f"{name} is out" for name in gone)])
        if not tasks:
            return ""
        for name, member in members.items():
            if _abilities(member) != self._members[name]:
                return f"{name} can do other things than before"
        for pair in sorted(frozenset(pauses) ^ self._pauses):
            return f"whether {pair[1]} may be asked for {pair[0]}"
        for name, member in members.items():
            usable_j, j_per_m = self._figures[name]
            now_j, now_j_per_m = _figures(member)
            battery = member.state.battery
            capacity_j = battery.remaining_j / max(battery.soc, 0.01) if battery is not None else PLENTY_J
            if abs(usable_j - now_j) > DRAINED_SHARE * capacity_j:
                return f"{name} has {now_j:.0f} J left, and had {usable_j:.0f} J"
            if abs(now_j_per_m - j_per_m) > DEARER_SHARE * j_per_m:
                return f"{name} takes {now_j_per_m:.1f} J a metre, and took {j_per_m:.1f} J"
        if area_m2 > self._area_m2 * (1.0 + GROWN_SHARE) and (left_out or self._area_m2 == 0.0):
            return f"the map has grown to {area_m2:.0f} m²"
        return ""

    def begun(self, task_id: str, robot: str) -> None:
        """Record that a task has begun as planned, which needs no new plan."""
        before = (task_id, TaskState.QUEUED, "")
        if before in self._tasks:
            self._tasks = self._tasks - {before} | {(task_id, TaskState.RUNNING, robot)}

    def note(
        self,
        records: Iterable[TaskRecord],
        members: dict[str, Member],
        pauses: Iterable[tuple[str, str]],
        area_m2: float,
    ) -> None:
        """Record the inputs of a plan."""
        self._tasks = _tasks(records)
        self._members = {name: _abilities(member) for name, member in members.items()}
        self._figures = {name: _figures(member) for name, member in members.items()}
        self._pauses = frozenset(pauses)
        self._area_m2 = area_m2


def _tasks(records: Iterable[TaskRecord]) -> frozenset[tuple[str, TaskState, str]]:
    running = (TaskState.OFFERED, TaskState.RUNNING)
    return frozenset(
        (record.task.id, TaskState.RUNNING if record.state in running else record.state, record.robot)
        for record in records
    )


def _difference(now: frozenset[tuple[str, TaskState, str]], before: frozenset[tuple[str, TaskState, str]]) -> str:
    """The first few tasks that have changed."""
    names = {task: state for task, state, _ in now}
    changed = sorted({task for task, _, _ in now ^ before})
    words = [f"{task} is {names[task].replace('_', ' ')}" if task in names else f"{task} has ended" for task in changed]
    return ", ".join(words[:3]) + (f" and {len(words) - 3} more" if len(words) > 3 else "")


def _abilities(member: Member) -> tuple[frozenset[str] | None, tuple[Point2D, ...], bool]:
    return member.offers, member.chargers, member.free_ns > 0


def _figures(member: Member) -> tuple[float, float]:
    model = member.state.energy
    return (PLENTY_J if model is None else model.usable_j, profile_of(model, 1.0).j_per_m)
