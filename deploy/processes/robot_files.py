"""ROBOT.toml files for the robots of a world, and the Serial Forwarders of their base stations that these tell of.

The process of a live arena opens the forwarders and says where they listen; who started it reads that.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType

import msgspec

from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.session import is_loopback
from robrain.sim.motes.serial_forwarder import SerialForwarder
from robrain.sim.world.world import World

NO_FORWARDERS: Mapping[str, str] = MappingProxyType({})
_SAID = "serial forwarder of "


def loadable_from_here(endpoints: Sequence[str]) -> list[Path]:
    """Folders to load plugins from while robots run: the working folder, if only this machine can reach the team.

    Empty if other machines can reach the team, or if that folder is the root of the disk.
    """
    here = Path.cwd()
    is_private = bool(endpoints) and all(map(is_loopback, endpoints))
    return [here] if is_private and here != Path(here.root) else []


def write_robot_files(
    world: World,
    folder: Path,
    *,
    team: str,
    connect: str,
    forwarders: Mapping[str, str] = NO_FORWARDERS,
    loadable: Sequence[Path] = (),
) -> list[Path]:
    """Write one file per robot into a folder.

    Args:
        world: start poses of the robots, and the grid of their maps.
        folder: it must exist.
        team: the robots' team.
        connect: endpoint that their agents connect to.
        forwarders: `host:port` of the robots' Serial Forwarders, written as a comment.
        loadable: folders from which plugins may be loaded while the robots run.

    """
    paths = []
    for robot in world.robots:
        robot_file = world.robot_file(robot, team=team, connect=(connect,))
        if loadable:
            table = msgspec.structs.replace(robot_file.robot, loadable=[str(each) for each in loadable])
            robot_file = msgspec.structs.replace(robot_file, robot=table)
        path = folder / f"{robot.name}.toml"
        path.write_bytes(note(robot.name, forwarders).encode() + msgspec.toml.encode(robot_file))
        paths.append(path)
    return paths


def open_forwarders(endpoint: Endpoint, robots: Iterable[str], closing: ExitStack) -> list[SerialForwarder]:
    """One a robot, each on a free port of loopback, closed with `closing`."""
    forwarders = []
    for robot in robots:
        forwarder = SerialForwarder(endpoint, robot)
        closing.callback(forwarder.close)
        forwarders.append(forwarder)
    return forwarders


def addresses(forwarders: Iterable[SerialForwarder]) -> dict[str, str]:
    """`host:port` of each robot's."""
    return {forwarder.robot: "{}:{}".format(*forwarder.address) for forwarder in forwarders}


def said(robot: str, address: str) -> str:
    """The line of output that tells of one.

    >>> said("r1", "127.0.0.1:9002")
    'serial forwarder of r1: 127.0.0.1:9002'
    """
    return f"{_SAID}{robot}: {address}"


def read_said(lines: Iterable[str]) -> dict[str, str]:
    """The addresses that lines of output tell of.

    >>> read_said(["arena: depot", "serial forwarder of r1: 127.0.0.1:9002"])
    {'r1': '127.0.0.1:9002'}
    """
    told = (line.removeprefix(_SAID).partition(": ") for line in lines if line.startswith(_SAID))
    return {robot: address for robot, _, address in told}


def note(robot: str, forwarders: Mapping[str, str]) -> str:
    """A comment for the robot's file; empty if it has no forwarder."""
    if robot not in forwarders:
        return ""
    host, _, port = forwarders[robot].partition(":")
    return (
        f"# While this arena runs, a Serial Forwarder of the robot's base station is at {host}:{port}. To go by it:\n"
        f'# [parameters.mote_base]\n# interface = "sf"\n# host = "{host}"\n# port = {port}\n\n'
    )
