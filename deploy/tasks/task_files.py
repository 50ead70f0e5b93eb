"""Tasks from a command line or from a JSON or TOML file; each mistake is reported in one sentence."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from robrain.client.submission import COMMON, RELATIVE, any_zone, submission_of
from robrain.deploy.errors import UsageError
from robrain.protocol.errors import BadToml
from robrain.protocol.messages.tasks.task_messages import Remedy, RobotVerdict, TaskDryRun, TaskEstimate
from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS
from robrain.protocol.toml_text import LARGE, parse_toml, read_toml_text


class TaskWords(NamedTuple):
    """A task as it was typed or read from a file."""

    kind: str
    fields: dict[str, Any]
    """Named as in the messages."""


def tasks_in(path: Path) -> list[TaskWords]:
    """The tasks of a file: JSON, an object or an array of them; or TOML, a table or several `[[task]]`.

    `[[tasks]]`, as in a scenario file, means the same.

    Raises:
        UsageError, BadTask: naming file and key.

    """
    try:
        text = read_toml_text(path, LARGE)
        content = json.loads(text) if path.suffix == ".json" else parse_toml(text, LARGE)
    except BadToml as error:
        raise UsageError(f"{path}: {error}") from error
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: not valid JSON: {error}") from error
    tasks = content.get("task", content.get("tasks", [content])) if isinstance(content, dict) else content
    tasks = tasks if isinstance(tasks, list) else [tasks]
    if not tasks or not all(isinstance(task, dict) for task in tasks):
        raise UsageError(f"{path}: expected tasks: a table with kind and id, or several [[task]]")
    found = []
    for number, task in enumerate(tasks, start=1):
        where = f"{path}: task {number}: "
        kind = task.pop("kind", None)
        if not isinstance(kind, str):
            raise UsageError(f"{where}expected kind, such as {', '.join(sorted(STOCK_KINDS))}")
        submission_of(kind, {"id": kind, **task}, where, zone_of=any_zone)  # check all before the first is submitted
        found.append(TaskWords(kind, task))
    return found


def parameters_set(words: Sequence[str], given: Mapping[str, Any]) -> dict[str, Any]:
    """Parse parameters of a kind of task, as `values_set` does.

    Raises:
        UsageError: one has another form, names a field with its own option, or is given twice.

    """
    found = values_set(words)
    for name in found:
        if name in COMMON or name in RELATIVE:
            raise UsageError(f"--set {name}: it is a field of every task; use its own option")
        if name in given:
            raise UsageError(f"--set {name}: it is given twice")
    return found


def values_set(words: Sequence[str]) -> dict[str, Any]:
    """Parse `NAME=VALUE`; values that are not JSON are text (UsageError for another form, or a name given twice)."""
    found: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not (name and equals):
            raise UsageError(f"--set {word}: expected NAME=VALUE")
        if name in found:
            raise UsageError(f"--set {name}: it is given twice")
        try:
            found[name] = json.loads(text)
        except (ValueError, RecursionError):
            found[name] = text
    return found


REMEDIES = 3
"""Changes that are shown."""


def verdict_line(verdict: RobotVerdict) -> str:
    """Cost of a task for a robot, or the reason why the robot is excluded."""
    words = []
    if verdict.path_m is not None:
        words.append(f"path {verdict.path_m:.1f} m")
    elif verdict.distance_m is not None:
        words.append(f"{verdict.distance_m:.1f} m away")
    words += [f"arrives in {verdict.arrives_in_s:.0f} s"] if verdict.arrives_in_s is not None else []
    words += [f"{verdict.energy_j:.0f} J"] if verdict.energy_j is not None else []
    words += [f"{verdict.left_soc:.0%} left at a charger"] if verdict.left_soc is not None else []
    words += ["chosen"] if verdict.chosen else [verdict.refusal] if verdict.refusal else []
    return f"  {verdict.robot}: {', '.join(words)}"


def dry_run_lines(found: TaskDryRun) -> list[str]:
    """Expected effects of a task."""
    task = found.task
    if found.refused:
        return [f"a task to {task.kind} would be refused: {found.refused}"]
    if found.known is not None:
        return [f"{task.id} was submitted before, and is {found.known}: nothing would change"]
    lines = [f"a task to {task.kind} at ({task.place.x_m:g}, {task.place.y_m:g}) would be accepted"]
    if found.waits:
        lines.append(f"it would wait: {found.waits}")
    if found.ahead:
        lines.append(f"open tasks that are at least as urgent: {found.ahead}")
    if found.estimate is not None:
        lines.append(estimate_text(found.estimate))
    lines += map(verdict_line, found.robots)
    lines += [remedy_text(remedy) for remedy in found.remedies[:REMEDIES]]
    if found.blocks:
        lines.append(f"while a robot is at it, no other gets to {', '.join(found.blocks)}")
    for delay in found.delays:
        later = "not be done" if delay.later_s is None else f"end {delay.later_s:.0f} s later"
        lines.append(f"{delay.task} would {later}{', after its deadline' if delay.misses_deadline else ''}")
    return lines


def remedy_text(remedy: Remedy) -> str:
    """A change with which a task could be done."""
    ends = "" if remedy.ends_in_s is None else f", in {remedy.ends_in_s:.0f} s"
    return f"  it could be done {remedy.words}{ends}"


def estimate_text(estimate: TaskEstimate) -> str:
    """When a task is expected to end, and at what cost."""
    interval = f"90 %: {estimate.ends_low_s:.0f} to {estimate.ends_high_s:.0f} s"
    return (
        f"{estimate.robot} arrives in {estimate.arrives_in_s:.0f} s and finishes in {estimate.ends_in_s:.0f} s"
        f" ({interval}), {estimate.energy_j:.0f} J{'; that is after its deadline' if estimate.is_late else ''}"
    )
