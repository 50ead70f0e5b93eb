"""Manifests: the TOML file beside a plugin's class with its name, its requirements and its permitted users."""

import os
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import msgspec

from robrain.agent.errors import ManifestError, PluginMissing
from robrain.agent.transform import TransformTable
from robrain.protocol.errors import BadName, BadToml
from robrain.protocol.file_mistakes import key_and_problem
from robrain.protocol.keys import check_name
from robrain.protocol.model.checked import Checked, convert
from robrain.protocol.model.ranges import NotNegativeInt, Positive
from robrain.protocol.toml_text import parse_toml, read_toml_text

ANYBODY = "*"
COMMAND = "command"
"""The name that opens a plugin to the outside."""
_PLUGIN_TABLE = re.compile(rb"^\s*\[\s*plugin\s*\]", re.MULTILINE)
_CHECKED_BYTES = 65536
TEXTS_KEPT = 512
"""Manifests whose parsed text is cached."""


class PluginTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_path": "class"}):
    """`[plugin]`."""

    class_path: str
    """`module:Class`; the module lies beside the manifest or can be imported."""
    role: str = ""
    """The plugin that it can replace, such as `scan`; it is loaded, under that name, only if `[robot.roles]` names
    it."""


class TagTable(Checked, frozen=True, forbid_unknown_fields=True):
    """`[tag]`."""

    visibility: list[str] = msgspec.field(default_factory=lambda: [COMMAND])
    """Plugins that may use this one; `command` for the outside, `*` for any plugin inside."""
    requires: list[str] = msgspec.field(default_factory=list)
    """Plugins that this one calls."""
    shared: bool = True
    """False: one user at a time."""
    restart: Literal["no", "on-failure"] = "no"
    """Restart policy after a fault."""
    restart_limit: NotNegativeInt = 5
    """Number of consecutive restarts after which the plugin stays faulted."""
    backoff_s: Positive = 0.5
    """Time before the first restart; it doubles with each one."""
    backoff_max_s: Positive = 30.0
    """Longest time before a restart."""
    hang_s: Positive = 5.0
    """A step or call that takes longer is taken for hung, in live."""
    start_s: Positive = 20.0
    """Time limit for each of its import, `init` and `activate`, in live."""
    essential: bool = False
    """Whether the robot is halted, and stays so, while this does not run."""
    isolation: Literal["none", "process"] = "none"
    """`process`: run it in a separate process, in live."""


class ManifestTables(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file."""

    plugin: PluginTable
    parameters: dict[str, Any] = {}
    tag: TagTable = TagTable()
    transform: TransformTable = TransformTable()


class Manifest(msgspec.Struct, frozen=True):
    """A manifest that has been read."""

    name: str
    """The plugin's name: that of its role if it has one, else the file's."""
    path: Path
    class_path: str
    parameters: dict[str, Any]
    tag: TagTable
    transform: TransformTable = TransformTable()

    @property
    def module_name(self) -> str:
        """The module of the plugin's class."""
        return self.class_path.partition(":")[0]


def read_manifest(path: Path) -> Manifest:
    """Read one manifest.

    Raises:
        ManifestError: with file, key and expected value.

    """
    try:
        name = check_name("plugin", path.stem)
    except BadName as error:
        raise ManifestError(path, "file name", str(error)) from error
    try:
        text = read_toml_text(path)
    except BadToml as error:
        raise ManifestError(path, "file", str(error)) from error
    return _manifest(name, path, text)


@lru_cache(maxsize=TEXTS_KEPT)
def _manifest(name: str, path: Path, text: str) -> Manifest:
    """By its text, so that the robots of one process read a file again and parse it once; a manifest is read-only."""
    try:
        raw = parse_toml(text)
    except BadToml as error:
        raise ManifestError(path, "file", str(error)) from error
    try:
        tables = convert(raw, ManifestTables)
    except msgspec.ValidationError as error:
        raise ManifestError(path, *key_and_problem(error, raw, ManifestTables)) from error
    role = tables.plugin.role
    if role:
        try:
            name = check_name("plugin", role)
        except BadName as error:
            raise ManifestError(path, "[plugin] role", str(error)) from error
    if ":" not in tables.plugin.class_path:
        raise ManifestError(path, "[plugin] class", f"expected module:Class, got {tables.plugin.class_path!r}")
    return Manifest(name, path, tables.plugin.class_path, tables.parameters, tables.tag, tables.transform)


def find_manifests(place: Path, *, most_files: int | None = None) -> list[Path]:
    """All manifests below a place, ordered by name: TOML files that have a [plugin] table.

    A file that cannot be parsed is included if it resembles a manifest: `read_manifest` then raises the error with the
    reason. Links to folders are not followed.

    Args:
        place: a folder.
        most_files: limit on the number of files and folders of any kind below it; no limit if None.

    Raises:
        PluginMissing: `place` holds more than `most_files`.

    """
    found = []
    for path in sorted(_toml_files(place, most_files)):
        try:
            if _has_plugin_table(read_toml_text(path)):
                found.append(path)
        except BadToml:
            if _resembles_manifest(path):
                found.append(path)
    return found


def role_in(path: Path) -> str:
    """The role that a manifest names; empty if it names none, or cannot be read, which `read_manifest` reports."""
    try:
        return _role(read_toml_text(path))
    except BadToml:
        return ""


@lru_cache(maxsize=TEXTS_KEPT)
def _role(text: str) -> str:
    plugin = parse_toml(text).get("plugin")
    role = plugin.get("role") if isinstance(plugin, dict) else None
    return role if isinstance(role, str) else ""


@lru_cache(maxsize=TEXTS_KEPT)
def _has_plugin_table(text: str) -> bool:
    return "plugin" in parse_toml(text)


def _toml_files(place: Path, most_files: int | None) -> Iterator[Path]:
    count = 0
    for folder, folders, files in os.walk(place):
        count += len(folders) + len(files)
        if most_files is not None and count > most_files:
            raise PluginMissing(
                place.name, f"more than {most_files} files are in that folder: name the plugin's own folder"
            )
        yield from (Path(folder, name) for name in files if name.endswith(".toml"))


def _resembles_manifest(path: Path) -> bool:
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            data = file.read(_CHECKED_BYTES)
    except OSError:
        return True  # possibly a manifest; `read_manifest` reports why it cannot be read
    return len(data) < _CHECKED_BYTES or _PLUGIN_TABLE.search(data) is not None
