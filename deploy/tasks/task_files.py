"""Tasks as a command line or a JSON or TOML file names them; each mistake is one sentence."""

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

from robrain.client.submission import KINDS, submission_of
from robrain.deploy.errors import UsageError
from robrain.protocol.wire.errors import BadToml
from robrain.protocol.wire.toml_text import LARGE, parse_toml, read_toml_text


class TaskWords(NamedTuple):
    """A task as it was written."""

    kind: str
    fields: dict[str, Any]
    """Named as in the messages."""


def tasks_in(path: Path) -> list[TaskWords]:
    """The tasks of a file: JSON, an object or an array of them; or TOML, a table or several `[[task]]`.

    Raises:
        UsageError, BadTask: naming file and key.

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
    found = []
    for number, task in enumerate(tasks, start=1):
        where = f"{path}: task {number}: "
        kind = task.pop("type", None)
        if not isinstance(kind, str):
            raise UsageError(f"{where}expected type, one of {', '.join(sorted(KINDS))}")
        submission_of(kind, {"id": kind, **task}, where)  # all of them are checked before the first is asked for
        found.append(TaskWords(kind, task))
    return found


def point(option: str, text: str) -> list[float]:
    """`3,4` as x and y, metres (UsageError naming the option)."""
    try:
        x_m, y_m = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"{option} {text}: expected X,Y in metres, such as 3,4.5") from error
    if not (math.isfinite(x_m) and math.isfinite(y_m)):
        raise UsageError(f"expected a finite {option}, got {text}")
    return [x_m, y_m]
