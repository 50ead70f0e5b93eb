"""Two recorded runs: their first difference, and their outcomes beside each other."""

import json
from collections.abc import Callable, Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import msgspec

from robrain.protocol.clock import to_seconds
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.stock_kinds import EXPLORE
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.drawing.labels import natural_key
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.reader.contents import half
from robrain.recording.reader.reading import read_messages
from robrain.recording.reader.recorded_message import RecordedMessage, topic_named_by
from robrain.recording.reader.run_data import OWN_KINDS, RunData, TaskRun, read_run

SHARES = (0.25, 0.5, 0.75, 0.9, 0.95)
"""Explored shares whose times are compared."""


class ComparedTask(msgspec.Struct, frozen=True, kw_only=True):
    """One task of a run."""

    task: str
    kind: str
    state: str
    """The last one: `done`, `failed`, `cancelled`, or its state when the run ended."""
    robot: str
    """The robot that did it, or worked on it last; empty if none did."""
    started_s: float | None
    ended_s: float | None
    why: str = ""


class RobotOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """One robot of a run."""

    robot: str
    distance_m: float | None
    """By the arena, as the next two; None without one."""
    energy_j: float | None
    collisions: int | None
    frontiers: int
    """Tasks of the coordinator's own that it did."""
    tasks: list[str]
    """Other tasks that it did."""


class ComparedRun(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of one run."""

    recording: Path
    duration_s: float
    explored_fraction: float | None
    """None without an arena."""
    explored_at_s: dict[str, float]
    """Time at which each share of the floor was explored, by its percentage, `50%`; without those not reached."""
    done: int
    """Tasks done, without the coordinator's own; the next one as well."""
    failed: int
    robots: list[RobotOutcome]
    tasks: list[ComparedTask]
    """Without those of the coordinator's own."""

    @property
    def distance_m(self) -> float | None:
        """Of all robots."""
        return _sum([robot.distance_m for robot in self.robots])

    @property
    def energy_j(self) -> float | None:
        """Of all robots."""
        return _sum([robot.energy_j for robot in self.robots])

    @property
    def collisions(self) -> int | None:
        """Of all robots."""
        reported = _sum([robot.collisions for robot in self.robots])
        return None if reported is None else round(reported)


class ComparedRow(msgspec.Struct, frozen=True, kw_only=True):
    """A line of the table of two runs."""

    group: str
    """`run`, `explored`, `tasks`, or the name of a robot."""
    name: str
    unit: str
    """Empty for a count and for words."""
    first: float | str | None
    second: float | str | None

    @property
    def difference(self) -> float | None:
        """Second less first; None for words, and where one is missing."""
        if isinstance(self.first, str) or isinstance(self.second, str) or self.first is None or self.second is None:
            return None
        return self.second - self.first

    @property
    def is_equal(self) -> bool:
        """Whether the runs are equal."""
        return self.first == self.second


class TwoRuns(msgspec.Struct, frozen=True, kw_only=True):
    """Two runs for a comparison."""

    first: ComparedRun
    second: ComparedRun

    @property
    def rows(self) -> list[ComparedRow]:
        """The lines of their table, grouped: the run, explored shares, each robot, each task."""
        ones, twos = _figures(self.first), _figures(self.second)
        keys = sorted(dict.fromkeys([*ones, *twos]), key=lambda key: (key[0], natural_key(key[1])))
        return [
            ComparedRow(group=key[1], name=key[2], unit=key[3], first=ones.get(key), second=twos.get(key))
            for key in keys
        ]


def compare_runs(one: Path | str, two: Path | str, on_progress: Callable[[float], None] | None = None) -> TwoRuns:
    """Read two recordings for their comparison.

    Raises:
        RecordingError: one of them cannot be read.

    """
    first, second = read_run(Path(one), half(on_progress, 0.0)), read_run(Path(two), half(on_progress, 0.5))
    return TwoRuns(first=outcome_of(first), second=outcome_of(second))


def outcome_of(run: RunData) -> ComparedRun:
    """The outcome of a run."""
    done = [task for task in run.tasks.values() if task.state == "done"]
    reached: dict[str, float] = {}
    for share in SHARES:
        at_s = next((t_s for t_s, explored in run.explored if explored >= share), None)
        if at_s is not None:
            reached[f"{share:.0%}"] = at_s
    return ComparedRun(
        recording=run.path,
        duration_s=run.duration_s,
        explored_fraction=run.explored[-1][1] if run.explored else None,
        explored_at_s=reached,
        done=run.count(TaskState.DONE),
        failed=run.count(TaskState.FAILED),
        robots=[
            RobotOutcome(
                robot=robot.name,
                distance_m=robot.distance_m,
                energy_j=robot.energy_j,
                collisions=robot.collisions,
                frontiers=sum(task.kind == EXPLORE and task.robot == robot.name for task in done),
                tasks=[task.name for task in done if task.kind not in OWN_KINDS and task.robot == robot.name],
            )
            for robot in sorted(run.robots.values(), key=lambda robot: natural_key(robot.name))
        ],
        tasks=[_task(task) for task in run.asked],
    )


RowKey = tuple[int, str, str, str]
"""Place of the group in the table, group, name and unit."""


def _figures(run: ComparedRun) -> dict[RowKey, float | str | None]:
    """The values of one run in the table."""
    figures: dict[RowKey, float | str | None] = {
        (0, "run", "duration", "s"): run.duration_s,
        (0, "run", "explored", "%"): None if run.explored_fraction is None else 100 * run.explored_fraction,
        (0, "run", "distance", "m"): run.distance_m,
        (0, "run", "energy", "J"): run.energy_j,
        (0, "run", "collisions", ""): run.collisions,
        (0, "run", "tasks done", ""): run.done,
        (0, "run", "tasks failed", ""): run.failed,
    }
    figures |= {(1, "explored", f"{share} after", "s"): at_s for share, at_s in run.explored_at_s.items()}
    for robot in run.robots:
        figures |= {
            (2, robot.robot, "distance", "m"): robot.distance_m,
            (2, robot.robot, "energy", "J"): robot.energy_j,
            (2, robot.robot, "collisions", ""): robot.collisions,
            (2, robot.robot, "frontiers", ""): robot.frontiers,
        }
        if robot.tasks:
            figures[2, robot.robot, "tasks", ""] = ", ".join(robot.tasks)
    return figures | {(3, "tasks", task.task, ""): _task_text(task) for task in run.tasks}


def text_of(row: ComparedRow) -> tuple[str, str, str]:
    """First, second and their difference in words; `–` for a missing value, and no difference of equal values.

    >>> text_of(ComparedRow(group="run", name="energy", unit="J", first=812.4, second=1034.0))
    ('812 J', '1,034 J', '+222 J')
    """
    difference = row.difference
    words = "" if difference is None or row.is_equal else _with_unit(difference, row.unit, "+")
    return _with_unit(row.first, row.unit), _with_unit(row.second, row.unit), words


def _with_unit(value: float | str | None, unit: str, sign: str = "") -> str:
    if value is None or isinstance(value, str):
        return value or "–"
    decimals = 0 if not unit or unit == "J" else 1
    return f"{value:{sign},.{decimals}f}" + (f" {unit}" if unit else "")


def _task(task: TaskRun) -> ComparedTask:
    return ComparedTask(
        task=task.name,
        kind=task.kind,
        state=str(task.state),
        robot=task.robot,
        started_s=task.started_s,
        ended_s=task.ended_s,
        why=task.reason,
    )


def _task_text(task: ComparedTask) -> str:
    """State, robot and time of a task, `done by r2 at 12.3 s`."""
    by = f" by {task.robot}" if task.robot else ""
    return task.state.replace("_", " ") + by + (f" at {task.ended_s:.1f} s" if task.ended_s is not None else "")


def _sum(values: list[float | None] | list[int | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) if known else None


VALUE_SHOWN = 200
"""Characters of a value that are shown."""
ENDED = "(the recording has ended)"


class Difference(msgspec.Struct, frozen=True, kw_only=True):
    """The first message in which two runs differ, seen from the first run; values as JSON, cut where long."""

    number: int
    """Index of the message among those of the wire, counted from 0."""
    time_s: float
    """Since the first message of the run."""
    key: str
    topic: str
    """Name in the table of topics; empty for other keys."""
    what: str
    """`key`, `time`, `field`, `payload`, or `end` when one run ends before the other."""
    path: str
    """JSON path of the field, such as `$.pose.x_m`; empty unless `what` is `field`."""
    first: str
    second: str


def first_difference(
    one: Path, two: Path, on_progress: Callable[[float], None] | None = None
) -> tuple[Difference | None, int]:
    """The first message in which two runs differ, or None; and how many are the same before it.

    Compared are key, time of recording since the first message, and payload of messages of the wire. Sequence numbers
    and stamps are in the payload.

    Raises:
        RecordingError: a file cannot be read.
    """
    start_one: int | None = None
    start_two: int | None = None
    number = 0
    for first, second in zip_longest(wire_messages(one, on_progress), wire_messages(two)):
        if start_one is None and first is not None:
            start_one = first.log_time_ns
        if start_two is None and second is not None:
            start_two = second.log_time_ns
        difference = compare_messages(number, first, second, start_one or 0, start_two or 0)
        if difference is not None:
            return difference, number
        number += 1
    return None, number


def wire_messages(path: Path, on_progress: Callable[[float], None] | None = None) -> Iterator[RecordedMessage]:
    """The messages of a recording that were on the wire, in order (RecordingError as from `read_messages`)."""
    return (message for message in read_messages(path, on_progress) if not is_visual(message.topic_key))


def compare_messages(
    number: int, first: RecordedMessage | None, second: RecordedMessage | None, start_one: int = 0, start_two: int = 0
) -> Difference | None:
    """Difference of two messages of the same number, or None.

    Args:
        number: of both in their runs.
        first: None if the first run has ended.
        second: None if the second has.
        start_one: the first run's clock from which times count, ns.
        start_two: the second's.

    """
    shown = first or second
    if shown is None:
        return None
    topic = topic_named_by(shown.topic_key)
    time_ns = first.log_time_ns - start_one if first is not None else shown.log_time_ns - start_two

    def difference(what: str, one: str, two: str, path: str = "") -> Difference:
        return Difference(
            number=number,
            time_s=to_seconds(time_ns),
            key=shown.topic_key,
            topic=topic.name if topic is not None else "",
            what=what,
            path=path,
            first=cut(one, VALUE_SHOWN),
            second=cut(two, VALUE_SHOWN),
        )

    if first is None or second is None:
        return difference(
            "end", ENDED if first is None else first.topic_key, ENDED if second is None else shown.topic_key
        )
    if first.topic_key != second.topic_key:
        return difference("key", first.topic_key, second.topic_key)
    if first.payload != second.payload:
        return _payload_difference(first, second, difference)
    second_ns = second.log_time_ns - start_two
    if time_ns != second_ns:
        return difference("time", f"{to_seconds(time_ns):.9f}", f"{to_seconds(second_ns):.9f}")
    return None


def _payload_difference(
    first: RecordedMessage, second: RecordedMessage, difference: Callable[..., Difference]
) -> Difference:
    try:
        one, two = msgspec.json.decode(first.payload), msgspec.json.decode(second.payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return difference("payload", repr(first.payload), repr(second.payload))
    found = differing_path(one, two)
    if found is None:  # the same values, written otherwise
        return difference("payload", repr(first.payload), repr(second.payload))
    path, value_one, value_two = found
    return difference("field", value_one, value_two, path)


def differing_path(one: Any, two: Any, path: str = "$") -> tuple[str, str, str] | None:
    """JSON path of the first difference of two decoded values, and both values as JSON; None when they are equal.

    >>> differing_path({"a": [1, {"b": 2}]}, {"a": [1, {"b": 3}]})
    ('$.a[1].b', '2', '3')
    >>> differing_path({"a": 1}, {"a": 1, "b": None})
    ('$.b', '(absent)', 'null')
    """
    if isinstance(one, dict) and isinstance(two, dict):
        for name in [*one, *(name for name in two if name not in one)]:
            here = f"{path}.{name}" if name.isidentifier() else f"{path}[{json.dumps(name)}]"
            if name not in one or name not in two:
                value_one, value_two = (_json(side[name]) if name in side else "(absent)" for side in (one, two))
                return here, value_one, value_two
            found = differing_path(one[name], two[name], here)
            if found is not None:
                return found
        return None
    if isinstance(one, list) and isinstance(two, list):
        for index, (item_one, item_two) in enumerate(zip(one, two, strict=False)):
            found = differing_path(item_one, item_two, f"{path}[{index}]")
            if found is not None:
                return found
        if len(one) != len(two):
            return f"{path}.length", str(len(one)), str(len(two))
        return None
    # True equals 1 in Python, and not in JSON.
    if type(one) is type(two) and one == two:
        return None
    return path, _json(one), _json(two)


def _json(value: Any) -> str:
    return msgspec.json.encode(value).decode()
