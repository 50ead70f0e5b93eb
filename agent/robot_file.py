"""ROBOT.toml: what one robot's agent needs to know before it starts."""

import tomllib
from pathlib import Path
from typing import Any, Literal

import msgspec

from robrain.agent.errors import RobotFileError
from robrain.agent.manifest import where_and_what
from robrain.protocol.wire.errors import BadName, WireError
from robrain.protocol.wire.keys import DEFAULT_TEAM, check_name
from robrain.protocol.wire.session import check_endpoint


class RobotTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """`[robot]`."""

    name: str
    team: str = DEFAULT_TEAM
    places: list[str] = []
    """Folders with plugins, beside the stock ones; relative to the file."""
    load: list[str] | None = None
    """Plugins to load, with what they require; all that are found if absent."""

    def __post_init__(self) -> None:
        try:
            check_name("robot", self.name)
            check_name("team", self.team)
        except BadName as error:
            raise ValueError(str(error)) from error


class ZenohTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[zenoh]`."""

    connect: list[str] = []
    listen: list[str] = []
    mode: Literal["client", "peer", "router"] = "client"

    def __post_init__(self) -> None:
        for endpoint in (*self.connect, *self.listen):
            try:
                check_endpoint(endpoint)
            except WireError as error:
                raise ValueError(str(error)) from error


class RobotFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file. `[parameters.PLUGIN]` overrides what a plugin's manifest says."""

    robot: RobotTable
    zenoh: ZenohTable = ZenohTable()
    parameters: dict[str, dict[str, Any]] = {}


def read_robot_file(path: Path) -> RobotFile:
    """Read a ROBOT.toml.

    Raises:
        RobotFileError: naming file, key and what was expected.

    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise RobotFileError(f"{path}: no such file; expected a ROBOT.toml with [robot] name") from error
    except (OSError, UnicodeDecodeError) as error:
        raise RobotFileError(f"{path}: cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise RobotFileError(f"{path}: is not TOML: {error}") from error
    try:
        robot_file = msgspec.convert(raw, RobotFile)
    except msgspec.ValidationError as error:
        where, what = where_and_what(error)
        raise RobotFileError(f"{path}: {where}: {what}") from error
    for place in robot_file.robot.places:
        if not (path.parent / place).is_dir():
            raise RobotFileError(f"{path}: robot.places: expected a folder, {path.parent / place} is none")
    return robot_file
