"""Reads journal records with values that are out of range by now: invalid fields get their defaults."""

import re
from typing import Any

import msgspec

from robrain.protocol.wire.task_messages import TaskRecord

FIELDS_MAX = 16
"""Maximum number of invalid fields per task."""
_PATH = re.compile(r" - at `\$\.([\w.]+)`$")


def read_record(text: str) -> tuple[TaskRecord, str]:
    """Decode a record of the journal; fields out of range get their defaults.

    Returns:
        The record, and what is wrong with it (empty if nothing).

    Raises:
        msgspec.DecodeError: the record cannot be read, or a field without a default is out of range.

    """
    try:
        return msgspec.json.decode(text, type=TaskRecord), ""
    except msgspec.ValidationError as error:
        why, last = str(error), error
    whole = msgspec.json.decode(text)
    for _ in range(FIELDS_MAX):
        found = _PATH.search(str(last))
        if found is None or "required" in str(last) or not _drop(whole, found[1].split(".")):
            break
        try:
            return msgspec.convert(whole, TaskRecord), why
        except msgspec.ValidationError as error:
            last = error
    raise last


def _drop(whole: Any, path: list[str]) -> bool:
    for name in path[:-1]:
        whole = whole.get(name) if isinstance(whole, dict) else None
    return isinstance(whole, dict) and whole.pop(path[-1], None) is not None
