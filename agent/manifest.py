"""Manifests: the TOML file beside a plugin's class that says who it is and who may use it."""

import tomllib
from pathlib import Path
from typing import Any, Literal

import msgspec

from robrain.agent.errors import ManifestError
from robrain.agent.transform import TransformTable
from robrain.protocol.wire.errors import BadName
from robrain.protocol.wire.keys import check_name

ANYBODY = "*"
COMMAND = "command"
"""The name that opens a plugin to the outside."""


class PluginTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_path": "class"}):
    """`[plugin]`."""

    class_path: str
    """`module:Class`; the module lies beside the manifest or can be imported."""


class TagTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[tag]`."""

    visibility: list[str] = msgspec.field(default_factory=lambda: [COMMAND])
    """Plugins that may use this one; `command` for the outside, `*` for anybody inside."""
    requires: list[str] = []
    """Plugins that this one calls."""
    shared: bool = True
    """False: one user at a time."""
    restart: Literal["no", "on-failure"] = "no"
    """What happens after a fault."""
    restart_limit: int = 5
    """After so many restarts in a row the plugin stays faulted."""
    backoff_s: float = 0.5
    """Time before the first restart; it doubles with each one."""
    hang_s: float = 5.0
    """A step or call that takes longer is taken for hung, in live."""
    start_s: float = 20.0
    """To import it, its `init` and its `activate` may take so long each, in live."""
    isolation: Literal["none", "process"] = "none"
    """`process`: run it in a process of its own, in live."""

    def __post_init__(self) -> None:
        for name in ("backoff_s", "hang_s", "start_s"):
            if not getattr(self, name) > 0:
                raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")
        if self.restart_limit < 0:
            raise ValueError(f"expected restart_limit >= 0, got {self.restart_limit}")


class ManifestTables(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file."""

    plugin: PluginTable
    parameters: dict[str, Any] = {}
    tag: TagTable = TagTable()
    transform: TransformTable = TransformTable()


class Manifest(msgspec.Struct, frozen=True):
    """A manifest that has been read; the file's name is the plugin's name."""

    name: str
    path: Path
    class_path: str
    parameters: dict[str, Any]
    tag: TagTable
    transform: TransformTable = TransformTable()


def read_manifest(path: Path) -> Manifest:
    """Read one manifest.

    Raises:
        ManifestError: naming file, key and what was expected.

    """
    try:
        name = check_name("plugin", path.stem)
    except BadName as error:
        raise ManifestError(path, "file name", str(error)) from error
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ManifestError(path, "file", f"cannot be read: {error}") from error
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:  # nested too deep, a number too long
        raise ManifestError(path, "file", f"is not TOML: {error}") from error
    try:
        tables = msgspec.convert(raw, ManifestTables)
    except msgspec.ValidationError as error:
        raise ManifestError(path, *where_and_what(error)) from error
    if ":" not in tables.plugin.class_path:
        raise ManifestError(path, "[plugin] class", f"expected module:Class, got {tables.plugin.class_path!r}")
    return Manifest(name, path, tables.plugin.class_path, tables.parameters, tables.tag, tables.transform)


def find_manifests(place: Path) -> list[Path]:
    """All manifests below a place, ordered by name: TOML files that have a [plugin] table."""
    found = []
    for path in sorted(place.rglob("*.toml")):
        try:
            if "plugin" in tomllib.loads(path.read_text(encoding="utf-8")):
                found.append(path)
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError, ValueError):
            found.append(path)  # reading it again says in words what is wrong
    return found


def where_and_what(error: msgspec.ValidationError) -> tuple[str, str]:
    """A validation error as the key that it is about and what was expected there.

    >>> where_and_what(msgspec.ValidationError("Expected `int`, got `str` - at `$.tag.shared`"))
    ('tag.shared', 'Expected `int`, got `str`')
    """
    what, _, where = str(error).partition(" - at `$")
    return where.rstrip("`").lstrip(".") or "file", what
