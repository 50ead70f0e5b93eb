"""New values in a robot's file: comments, order and all else in it stay."""

import os
import shutil
import tempfile
from collections.abc import Mapping, MutableMapping, MutableSequence
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from robrain.agent.host.robot_file import read_robot_file
from robrain.deploy.bringup.findings import Patch
from robrain.deploy.errors import UsageError

PARAMETERS = "parameters"
BACKUPS_MAX = 1000


def patched(parameters: Mapping[str, Any], patch: Mapping[str, Any]) -> dict[str, Any]:
    """One table over another, within nested tables too; lists are replaced.

    >>> patched({"scan": {"silent_s": 3.0}}, {"scan": {"mount": {"yaw_rad": 1.5}}})
    {'scan': {'silent_s': 3.0, 'mount': {'yaw_rad': 1.5}}}
    """
    found = dict(parameters)
    for key, value in patch.items():
        below = found.get(key)
        found[key] = (
            patched(below if isinstance(below, Mapping) else {}, value) if isinstance(value, Mapping) else value
        )
    return found


def write_patch(path: Path, patch: Patch, backup: Path | None) -> Path:
    """Write new values into a robot's file, which is replaced as a whole or not at all.

    Args:
        path: the file.
        patch: what to change.
        backup: a copy that was made before; None makes one.

    Returns:
        The copy of the file as it was.

    Raises:
        UsageError: the file is not as it was read, or cannot be written.
        RobotFileError: it would not be a robot's file any more.

    """
    try:
        document = tomlkit.parse(path.read_text(encoding="utf-8-sig"))
        if PARAMETERS not in document:
            document[PARAMETERS] = tomlkit.table(is_super_table=True)
        _put(document[PARAMETERS], patch)
        kept = backup or _backup(path)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".toml")
        new = Path(name)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                stream.write(tomlkit.dumps(document))
                stream.flush()
                os.fsync(stream.fileno())
            read_robot_file(new)
            shutil.copymode(path, new)
            new.replace(path)
        finally:
            new.unlink(missing_ok=True)
    except (OSError, TOMLKitError) as error:
        raise UsageError(f"{path}: cannot write what was found: {error}") from error
    return kept


def _backup(path: Path) -> Path:
    for number in range(1, BACKUPS_MAX):
        copy = path.with_name(f"{path.name}.before-bringup{'' if number == 1 else f'-{number}'}")
        try:
            with path.open("rb") as source, copy.open("xb") as target:
                shutil.copyfileobj(source, target)
        except FileExistsError:
            continue
        shutil.copystat(path, copy)
        return copy
    raise UsageError(f"{path}: too many copies {path.name}.before-bringup-… beside it")


def _put(table: MutableMapping[str, Any], patch: Mapping[str, Any]) -> None:
    for key, value in patch.items():
        there = table.get(key)
        if isinstance(value, Mapping):
            if not isinstance(there, MutableMapping):
                table[key] = tomlkit.table()
            _put(table[key], value)
        elif not _changed_in_place(there, value) and there != value:
            table[key] = value


def _changed_in_place(there: Any, value: Any) -> bool:
    """Change a list of tables one by one, so that their comments stay; whether that was possible."""
    if not (isinstance(there, MutableSequence) and isinstance(value, list) and len(there) == len(value) > 0):
        return False
    if not all(isinstance(one, Mapping) for one in (*there, *value)):
        return False
    for old, new in zip(there, value, strict=True):
        for key in [key for key in old if key not in new]:
            del old[key]
        _put(old, new)
    return True
