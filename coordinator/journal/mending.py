"""Reads journal records of older versions, and records with values that are now out of range.

Invalid fields get their defaults.

A reason with an unknown code, from a newer robrain, is dropped; its text remains.
"""

import re
from typing import Any

import msgspec

from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.tasks.old_form import upgraded, upgraded_json
from robrain.protocol.reasons import TaskReason

FIELDS_MAX = 16
"""Maximum number of invalid fields per task."""
_REASON: msgspec.json.Decoder[TaskReason | None] = msgspec.json.Decoder(TaskReason | None)
_PATH = re.compile(r" - at `\$\.([\w.]+)`$")


def read_record(text: str) -> tuple[TaskRecord, str]:
    """Decode a record of the journal; fields out of range get their defaults.

    Returns:
        The record, and its problem (empty if there is none).

    Raises:
        msgspec.DecodeError: the record cannot be read, or a field without a default is out of range.

    """
    try:
        return msgspec.json.decode(text, type=TaskRecord), ""
    except msgspec.ValidationError:
        pass
    whole = upgraded(msgspec.json.decode(text))
    if isinstance(whole, dict) and not _is_reason(whole.get("reason")):
        del whole["reason"]
    problem = ""
    for _ in range(FIELDS_MAX):
        try:
            return msgspec.convert(whole, TaskRecord), problem
        except msgspec.ValidationError as error:
            problem = problem or str(error)
            found = _PATH.search(str(error))
            if found is None or "required" in str(error) or not _drop(whole, found[1].split(".")):
                raise
    return msgspec.convert(whole, TaskRecord), problem


def read_reason(text: str) -> TaskReason | None:
    """A reason as the journal has it; None if there is none, or if it cannot be read."""
    try:
        return _REASON.decode(upgraded_json(text.encode()))
    except msgspec.DecodeError:
        return None


def _is_reason(value: Any) -> bool:
    try:
        msgspec.convert(value, TaskReason | None)
    except msgspec.ValidationError:
        return False
    return True


def _drop(whole: Any, path: list[str]) -> bool:
    for name in path[:-1]:
        whole = whole.get(name) if isinstance(whole, dict) else None
    return isinstance(whole, dict) and whole.pop(path[-1], None) is not None
