"""ROBOT.toml: configuration of one robot's agent before it starts."""

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from robrain.agent.errors import RobotFileError
from robrain.protocol.errors import BadName, BadToml, WireError
from robrain.protocol.file_mistakes import tables_of
from robrain.protocol.keys import DEFAULT_TEAM, check_name
from robrain.protocol.toml_text import read_toml
from robrain.protocol.wire.session import check_endpoint


class RobotTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """`[robot]`."""

    name: str
    team: str = DEFAULT_TEAM
    places: list[str] = []
    """Folders with plugins, beside the stock ones; relative to the file."""
    loadable: list[str] = []
    """More folders from which plugins may be loaded by path while the robot runs. They are not searched at the start.
    Relative to the file; `~` is the home folder of the user that runs the robot."""
    load: list[str] | None = None
    """Plugins to load; the plugins that they require are added. If absent, all plugins found are loaded."""
    roles: dict[str, str] = {}
    """Replacements of plugins, such as `scan = "ld19"`: `ld19` runs under the name `scan`, with `[parameters.scan]`."""
    consensus: bool = False
    """Whether the robot continues without a coordinator and allocates open tasks with the other robots."""

    def __post_init__(self) -> None:
        try:
            check_name("robot", self.name)
            check_name("team", self.team)
        except BadName as error:
            raise ValueError(str(error)) from error


class TlsTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[zenoh.tls]`: the robot's certificate, to connect to `tls/…`."""

    folder: str
    """Made by `robrain pki issue robot NAME`, with `ca.pem`, `certificate.pem` and `key.pem`. Relative to the file."""


class ZenohTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[zenoh]`."""

    connect: list[str] = []
    listen: list[str] = []
    mode: Literal["client", "peer", "router"] = "client"
    """Default: `router` in a file with `listen`, so that others can join, else `client`."""
    telemetry_bytes_per_s: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0
    """Capacity of the robot's link; states and links beyond it are dropped and counted. 0: everything is sent."""

    tls: TlsTable | msgspec.UnsetType = msgspec.UNSET

    def __post_init__(self) -> None:
        for endpoint in (*self.connect, *self.listen):
            try:
                check_endpoint(endpoint)
            except WireError as error:
                raise ValueError(str(error)) from error
        if self.listen and self.mode == "client":
            raise ValueError("mode: expected peer or router together with listen, got client")


class RobotFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file. `[parameters.PLUGIN]` overrides a plugin's manifest."""

    robot: RobotTable
    zenoh: ZenohTable = ZenohTable()
    parameters: dict[str, dict[str, Any]] = {}


def folder_of(base: Path, folder: str) -> Path:
    """The path of a folder named in a robot's file.

    Args:
        base: the file's folder.
        folder: relative to `base`, absolute, or `~/…`.

    Raises:
        RobotFileError: `~name` of a user that has no home folder.

    """
    try:
        return base / Path(folder).expanduser()
    except RuntimeError as error:  # `~name` of an unknown user
        raise RobotFileError(f"robot: cannot find the folder {folder}: {error}") from error


def read_robot_file(path: Path) -> RobotFile:
    """Read a ROBOT.toml.

    Raises:
        RobotFileError: with file, key and expected value.

    """
    try:
        raw = read_toml(path)
        zenoh = raw.get("zenoh")
        if isinstance(zenoh, dict) and zenoh.get("listen"):
            zenoh.setdefault("mode", "router")
        robot_file = tables_of(raw, RobotFile)
    except BadToml as error:
        raise RobotFileError(f"{path}: {error}") from error
    tls = robot_file.zenoh.tls
    for key, folders in (("places", robot_file.robot.places), ("loadable", robot_file.robot.loadable)):
        for folder in folders:
            found = folder_of(path.parent, folder)
            if not found.is_dir():
                raise RobotFileError(f"{path}: robot.{key}: expected a folder, {found} is not one")
    if isinstance(tls, TlsTable) and not folder_of(path.parent, tls.folder).is_dir():
        raise RobotFileError(
            f"{path}: zenoh.tls.folder: expected a folder, {folder_of(path.parent, tls.folder)} is not one"
        )
    return robot_file
