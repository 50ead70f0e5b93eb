"""ROBOT.toml files for the robots of a world."""

from pathlib import Path

import msgspec

from robrain.sim.world import World


def write_robot_files(world: World, folder: Path, *, team: str, connect: str) -> list[Path]:
    """Write one file a robot into a folder.

    Args:
        world: where the robots start, and which grid they map on.
        folder: it must exist.
        team: of the robots.
        connect: endpoint that their agents connect to.

    """
    paths = []
    for robot in world.robots:
        robot_file = world.robot_file(robot, team=team, connect=(connect,))
        path = folder / f"{robot.name}.toml"
        path.write_bytes(msgspec.toml.encode(robot_file))
        paths.append(path)
    return paths
