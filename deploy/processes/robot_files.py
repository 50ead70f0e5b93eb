"""ROBOT.toml files for the robots of a world."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import msgspec

from robrain.deploy.processes.forwarders import note
from robrain.protocol.wire.session import is_loopback
from robrain.sim.world.world import World

NO_FORWARDERS: Mapping[str, str] = MappingProxyType({})


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
