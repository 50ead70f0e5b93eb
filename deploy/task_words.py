"""Tasks from the words of a command line, or from a JSON or TOML file; each mistake is one sentence."""

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args
from uuid import uuid4

import msgspec

from robrain.deploy.errors import UsageError
from robrain.protocol.model.task import Task
from robrain.protocol.wire.errors import BadName, BadToml
from robrain.protocol.wire.keys import check_name
from robrain.protocol.wire.task_messages import TaskSubmission
from robrain.protocol.wire.toml_text import LARGE, parse_toml, read_toml_text

KINDS: dict[str, type[msgspec.Struct]] = {str(kind.__struct_config__.tag): kind for kind in get_args(Task)}
"""Each kind of task by its tag."""
POINTS = ("place", "goal", "look_at")
RELATIVE = ("earliest_in_s", "deadline_in_s")
ENGLISH = ("id", "needs", "after", "mote", "robot", "robots")
"""Fields whose names are also English words."""
AS_ON_THE_WIRE: Mapping[str, str] = MappingProxyType({})
"""Task files use the field names of the messages."""


def submission_of(
    kind: str, fields: Mapping[str, Any], where: str = "", typed: Mapping[str, str] = AS_ON_THE_WIRE
) -> TaskSubmission:
    """Build a task request from a kind and its fields, named as in the messages.

    Args:
        kind: the task's tag.
        fields: the given fields; `earliest_in_s` and `deadline_in_s` count from now. A missing id is generated.
        where: file and number of the task, for the error message.
        typed: command-line form of fields that are not typed by their name.

    Raises:
        UsageError: names the invalid field.

    """
    known = KINDS.get(kind)
    if known is None:
        raise UsageError(f"{where}expected a kind of task, one of {', '.join(sorted(KINDS))}; got {kind!r}")
    allowed = {field.name for field in msgspec.structs.fields(known)}
    for name in fields:
        if name not in allowed and name not in RELATIVE:
            known_as = sorted({typed.get(field, field) for field in allowed})
            raise UsageError(f"{where}a task to {kind} has no {typed.get(name, name)}; it has {', '.join(known_as)}")
    content = {"id": f"{kind}-{uuid4().hex[:8]}", **fields, "type": kind}
    for name in POINTS:
        at = content.get(name)
        if isinstance(at, list | tuple):
            if len(at) != 2:
                raise UsageError(f"{where}expected {name} as two numbers, x and y in metres; got {at!r}")
            content[name] = {"x_m": at[0], "y_m": at[1]}
    times = {name: content.pop(name) for name in RELATIVE if name in content}
    try:
        submission = msgspec.convert({"task": content, **times}, TaskSubmission)
        check_name("task", submission.task.id)
    except msgspec.ValidationError as error:
        raise UsageError(f"{where}{_words(str(error), kind, typed)}") from error
    except BadName as error:
        option = f"{typed['id']}: " if "id" in typed else ""
        raise UsageError(f"{where}{option}{error}") from error
    return submission


def submissions_in(path: Path) -> list[TaskSubmission]:
    """The tasks of a file: JSON, an object or an array of them; or TOML, a table or several `[[task]]`.

    Raises:
        UsageError: naming file and key.

    """
    try:
        text = read_toml_text(path, LARGE)
        content = json.loads(text) if path.suffix == ".json" else parse_toml(text, LARGE)
    except FileNotFoundError as error:
        raise UsageError(f"{path}: cannot be read: there is none") from error
    except BadToml as error:
        raise UsageError(f"{path}: {error}") from error
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: is no JSON: {error}") from error
    tasks = content.get("task", [content]) if isinstance(content, dict) else content
    tasks = tasks if isinstance(tasks, list) else [tasks]
    if not tasks or not all(isinstance(task, dict) for task in tasks):
        raise UsageError(f"{path}: expected tasks: a table with type and id, or several [[task]]")
    submissions = []
    for number, task in enumerate(tasks, start=1):
        where = f"{path}: task {number}: "
        kind = task.get("type")
        if not isinstance(kind, str):
            raise UsageError(f"{where}expected type, one of {', '.join(sorted(KINDS))}")
        fields = {name: value for name, value in task.items() if name != "type"}
        submissions.append(submission_of(kind, fields, where))
    return submissions


def point(option: str, text: str) -> list[float]:
    """`3,4` as x and y, metres (UsageError naming the option)."""
    try:
        x_m, y_m = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"{option} {text}: expected X,Y in metres, such as 3,4.5") from error
    if not (math.isfinite(x_m) and math.isfinite(y_m)):
        raise UsageError(f"expected a finite {option}, got {text}")
    return [x_m, y_m]


def _words(text: str, kind: str, typed: Mapping[str, str]) -> str:
    text, _, place = text.partition(" - at `$.")
    name = place.rstrip("`").removeprefix("task.").removeprefix("task")
    missing = text.removeprefix("Object missing required field ")
    if missing != text:
        field = missing.strip("`")
        return f"a task to {kind} needs {typed.get(field, field)}"
    field, _, rest = name.partition(".")
    if field:
        return f"{typed.get(field, field)}{f'.{rest}' if rest else ''}: {text}"
    # Errors of the task types name fields within English text, where "robot" and "after" are also plain words.
    return re.sub(r"\w+", lambda word: typed.get(word[0], word[0]) if word[0] not in ENGLISH else word[0], text)
