"""Reads tasks of recordings and journals from before kinds were open.

Then each kind was a struct of its own: its parameters stood beside the common fields, the kind was the tag `type`, and
the place of an `explore` was its `goal`.
"""

from typing import Any

import msgspec

from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS
from robrain.protocol.model.tasks.task import Task

TAG, GOAL = "type", "goal"
COMMON = frozenset(field.name for field in msgspec.structs.fields(Task))


def upgraded(content: Any) -> Any:
    """Bring what holds a `task` to today's form.

    Args:
        content: a decoded message, record or request.

    Returns:
        The same with its task in today's form; `content` itself if it holds no task of the old form.

    """
    task = content.get("task") if isinstance(content, dict) else None
    if not isinstance(task, dict) or "kind" in task or task.get(TAG) not in STOCK_KINDS:
        return content
    kind = task[TAG]
    own = {field.name for field in msgspec.structs.fields(STOCK_KINDS[kind])}
    today = {name: value for name, value in task.items() if name in COMMON} | {"kind": kind}
    if GOAL in task:
        today["place"] = task[GOAL]
    parameters = {name: value for name, value in task.items() if name in own}
    if parameters:
        today["parameters"] = parameters
    return {**content, "task": today}


def upgraded_json(payload: bytes) -> bytes:
    """The same of JSON; a payload that holds no task of the old form, or is no JSON, is returned as it is."""
    if b'"task":{"type":' not in payload:
        return payload
    try:
        return msgspec.json.encode(upgraded(msgspec.json.decode(payload)))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return payload
