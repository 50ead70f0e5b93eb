"""An arena that is started again goes on with the robots where they were: a file of their true poses.

The file is written by `robrain up` from the last `arena/truth`. Batteries, motes and moving bodies start again.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from robrain.deploy.errors import UsageError
from robrain.protocol.messages.team.arena_messages import ArenaTruth
from robrain.protocol.model.geometry import Pose2D

if TYPE_CHECKING:
    from robrain.sim.world.world import World

BYTES_MAX = 16 * 1024 * 1024


def write_resume(path: Path, truth: ArenaTruth) -> Path:
    """Write where the robots are; returns the path."""
    path.write_bytes(msgspec.json.encode({robot.robot: robot.pose for robot in truth.robots}))
    return path


def resumed(world: "World", path: Path) -> "World":
    """The world with its robots where a file says; those that it does not name stay at their starts.

    Raises:
        UsageError: the file cannot be read.

    """
    try:
        with path.open("rb") as file:
            poses = msgspec.json.decode(file.read(BYTES_MAX), type=dict[str, Pose2D])
    except (OSError, msgspec.MsgspecError) as error:
        raise UsageError(f"--resume {path}: {error}") from error
    robots = [msgspec.structs.replace(robot, start=poses.get(robot.name, robot.start)) for robot in world.robots]
    return replace(world, robots=robots)
