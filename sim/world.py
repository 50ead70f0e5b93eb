"""A world: a scenario's floor with its robots and motes in their places, for one seed."""

import io
import math
from dataclasses import dataclass

import numpy as np
from PIL import Image

from robrain.agent.robot_file import RobotFile, RobotTable, ZenohTable
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.keys import DEFAULT_TEAM
from robrain.sim.arena import ArenaRobot
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.maps.placement import scatter_points, spawn_poses
from robrain.sim.motes import ArenaMote
from robrain.sim.referee import team_geometry

ROBOT_RADIUS_M = 0.20
ROBOT_SPACING_M = 0.7
MOTE_CLEARANCE_M = 0.1


@dataclass(frozen=True)
class World:
    """Everything that is put into an arena."""

    plan: FloorPlan
    robots: list[ArenaRobot]
    motes: list[ArenaMote]
    seed: int

    def arena_rng(self) -> np.random.Generator:
        """The randomness of the arena."""
        return np.random.default_rng([self.seed, 1])

    def robot_file(self, robot: ArenaRobot, *, team: str = DEFAULT_TEAM, connect: tuple[str, ...] = ()) -> RobotFile:
        """What a robot's agent has to know of this world: where it starts, and the grid to map on."""
        geometry = team_geometry(self.plan)
        return RobotFile(
            robot=RobotTable(robot.name, team),
            zenoh=ZenohTable(connect=list(connect)),
            parameters={
                "localisation": {
                    "x_m": robot.start.x_m,
                    "y_m": robot.start.y_m,
                    "yaw_rad": robot.start.yaw_rad,
                },
                "mapper": {
                    "resolution_m": geometry.resolution_m,
                    "origin_x_m": geometry.origin_x_m,
                    "origin_y_m": geometry.origin_y_m,
                    "width_m": geometry.width * geometry.resolution_m,
                    "height_m": geometry.height * geometry.resolution_m,
                },
                "battery": {"capacity_wh": robot.battery_wh},
            },
        )

    def map_png(self) -> bytes:
        """The true floor as a picture: north up, walls black."""
        picture = Image.fromarray(np.where(self.plan.occupied, 0, 254).astype(np.uint8)[::-1])
        buffer = io.BytesIO()
        picture.save(buffer, format="PNG")
        return buffer.getvalue()


def build_world(plan: FloorPlan, robots: int, motes: int, near: Point2D | None, seed: int) -> World:
    """Put robots and motes on a floor.

    Raises:
        PlacementError: they do not fit.

    """
    rng = np.random.default_rng([seed, 0])
    poses = spawn_poses(plan, robots, ROBOT_RADIUS_M, near=near, rng=rng, spacing_m=ROBOT_SPACING_M)
    arena_robots = [
        ArenaRobot(name=f"r{number}", start=pose, radius_m=ROBOT_RADIUS_M) for number, pose in enumerate(poses, 1)
    ]
    reachable = plan.reachable([Point2D(pose.x_m, pose.y_m) for pose in poses], ROBOT_RADIUS_M)
    places: list[Point2D] = []
    if motes:
        area_m2 = float(reachable.sum()) * plan.resolution_m**2
        spacing_m = 0.7 * math.sqrt(area_m2 / motes)
        places = scatter_points(plan, motes, reachable, rng=rng, min_clearance_m=MOTE_CLEARANCE_M, spacing_m=spacing_m)
    arena_motes = [ArenaMote(name=f"m{number}", number=number, place=place) for number, place in enumerate(places, 1)]
    return World(plan, arena_robots, arena_motes, seed)
