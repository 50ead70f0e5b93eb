"""Tasks from a kind and its fields; each mistake is one sentence."""

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, get_args

import msgspec

from robrain.client.errors import BadTask
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.errors import BadName
from robrain.protocol.wire.keys import check_name
from robrain.protocol.wire.task_messages import TaskSubmission

KINDS: dict[str, type[msgspec.Struct]] = {str(kind.__struct_config__.tag): kind for kind in get_args(Task)}
"""Each kind of task by its tag."""
POINTS = ("place", "goal", "look_at")
RELATIVE = ("earliest_in_s", "deadline_in_s")
ENGLISH = ("id", "needs", "after", "mote", "robot", "robots")
"""Fields whose names are also English words."""
AS_ON_THE_WIRE: Mapping[str, str] = MappingProxyType({})
"""Scripts and task files use the field names of the messages."""


def submission_of(
    kind: str, fields: Mapping[str, Any], where: str = "", typed: Mapping[str, str] = AS_ON_THE_WIRE
) -> TaskSubmission:
    """Build a task request from a kind and its fields, named as in the messages.

    Args:
        kind: the task's tag.
        fields: the given fields, with an `id`; `earliest_in_s` and `deadline_in_s` count from now. A point may be two
            numbers. `place` is where the task is done, whatever its kind calls that.
        where: file and number of the task, for the error message.
        typed: command-line form of fields that are not typed by their name.

    Raises:
        BadTask: names the invalid field.

    """
    known = KINDS.get(kind)
    if known is None:
        raise BadTask(f"{where}expected a kind of task, one of {', '.join(sorted(KINDS))}; got {kind!r}")
    allowed = {field.name for field in msgspec.structs.fields(known)}
    content = {_name_in(allowed, name): value for name, value in fields.items()}
    for name in content:
        if name not in allowed and name not in RELATIVE:
            known_as = sorted({typed.get(field, field) for field in allowed})
            raise BadTask(f"{where}a task to {kind} has no {typed.get(name, name)}; it has {', '.join(known_as)}")
    content["type"] = kind
    for name in POINTS:
        at = content.get(name)
        if isinstance(at, list | tuple):
            if len(at) != 2:
                raise BadTask(f"{where}expected {name} as two numbers, x and y in metres; got {at!r}")
            content[name] = {"x_m": at[0], "y_m": at[1]}
    times = {name: content.pop(name) for name in RELATIVE if name in content}
    try:
        submission = msgspec.convert(msgspec.to_builtins({"task": content, **times}), TaskSubmission)
        check_name("task", submission.task.id)
    except (msgspec.ValidationError, TypeError) as error:
        raise BadTask(f"{where}{_words(str(error), kind, typed)}") from error
    except BadName as error:
        option = f"{typed['id']}: " if "id" in typed else ""
        raise BadTask(f"{where}{option}{error}") from error
    return submission


def _name_in(allowed: set[str], name: str) -> str:
    return "goal" if name == "place" and name not in allowed and "goal" in allowed else name


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
