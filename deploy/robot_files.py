"""ROBOT.toml files for the robots of a world."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import msgspec

from robrain.deploy.forwarders import note
from robrain.sim.world import World

NO_FORWARDERS: Mapping[str, str] = MappingProxyType({})


def write_robot_files(
    world: World, folder: Path, *, team: str, connect: str, forwarders: Mapping[str, str] = NO_FORWARDERS
) -> list[Path]:
    """Write one file a robot into a folder.

    Args:
        world: where the robots start, and which grid they map on.
        folder: it must exist.
        team: of the robots.
        connect: endpoint that their agents connect to.
        forwarders: `host:port` of robots' Serial Forwarders, which a comment tells of.

    """
    paths = []
    for robot in world.robots:
        robot_file = world.robot_file(robot, team=team, connect=(connect,))
        path = folder / f"{robot.name}.toml"
        path.write_bytes(note(robot.name, forwarders).encode() + msgspec.toml.encode(robot_file))
        paths.append(path)
    return paths
