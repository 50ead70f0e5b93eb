"""Picture for viewers before the first step of a lockstep run: the floor plan, and robots and motes at their places."""

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.protocol.messages.team import arena_messages
from robrain.protocol.messages.team.arena_messages import ArenaPreparation, ArenaTruth, MoteTruth, RobotTruth
from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.maps.floor_plan import FloorPlan, classes_on
from robrain.sim.maps.wall_shapes import touchable_cells
from robrain.sim.world.referee import team_geometry
from robrain.sim.world.world import World

WHO = "arena"


class StartPicture:
    """Publishes the picture. No component of the run receives it, and it is not recorded, so it changes no digest.

    Args:
        endpoint: endpoint of the picture; closed with it.
        world: whose robots need not be set up yet.

    """

    def __init__(self, endpoint: Endpoint, world: World) -> None:
        self._endpoint = endpoint
        self._publisher = endpoint.publisher(arena_messages.ARENA_PREPARATION)
        cells = PatchCells(0, 0, floor_classes(world.plan), 0)
        floor = to_message(WHO, team_geometry(world.plan), cells)
        self._blank = ArenaPreparation(parts_ready=0, parts=0, floor=floor, truth=start_truth(world))

    def show(self, parts_ready: int, parts: int, remaining_s: float | None) -> None:
        """Publish the picture, with the number of compiled parts, that of all parts, and the time left."""
        blank = self._blank
        self._publisher.put(
            ArenaPreparation(
                parts_ready=parts_ready, parts=parts, remaining_s=remaining_s, floor=blank.floor, truth=blank.truth
            )
        )

    def close(self) -> None:
        """Publish it no more."""
        self._endpoint.close()


def start_truth(world: World) -> ArenaTruth:
    """Places of robots and motes before the first step."""
    robots = [
        RobotTruth(robot=robot.name, pose=robot.start, collisions=0, distance_m=0.0, energy_j=0.0)
        for robot in world.robots
    ]
    return ArenaTruth(
        sim_time_s=0.0,
        robots=robots,
        motes=[MoteTruth(mote=mote.name, place=mote.place) for mote in world.motes],
    )


def floor_classes(plan: FloorPlan) -> NDArray[np.int8]:
    """The plan on the grid of the team's map: int8 (height, width), row 0 at the lowest y.

    A cell is occupied if it has a part of a wall's surface, and unknown inside walls and outside the plan.
    """
    return classes_on(team_geometry(plan), plan.geometry, ~plan.occupied, touchable_cells(plan.occupied))
