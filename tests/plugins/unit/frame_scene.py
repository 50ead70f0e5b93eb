"""A robot that maps a room in a frame of its own, and mates that have mapped it in another."""

import math
from collections.abc import Callable

import numpy as np

from robrain.algorithms.mapping.local_map import NO_DRIFT
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper.frames import Frames
from robrain.plugins.skill.mapper.own_submaps import OwnSubmaps, SubmapSpec
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.map_frame import ARENA, MapFrame
from tests.algorithms.mapping.lidar_floor import ANGLES_RAD, NOBODY, RANGE_M, ROOM, ROOM_PLACES

WIDE = GridGeometry(0.1, -12.0, -12.0, 240, 240)
OWN, MATES = MapFrame(20, "r1"), MapFrame(10, "r2")
WHY = "it was carried"
SURE = np.diag((0.01, 0.01, 0.001))
T_OWN_FLOOR = Pose2D(-2.0, 1.0, 2.1)
"""How the floor lies in the robot's own frame."""
PLACES = [Pose2D(1.0, 1.0, 0.0), Pose2D(2.1, 3.12, 0.0), Pose2D(4.5, 5.0, 0.0), Pose2D(4.5, 1.0, 0.0)]


def room_classes() -> np.ndarray:
    grid = OccupancyGrid(WIDE)
    for stamp_ms, place in enumerate(ROOM_PLACES, 1):
        grid.integrate_scan(place, ANGLES_RAD, ROOM.ranges_m(place), RANGE_M, stamp_ms, NOBODY)
    return grid.classes()


ROOM_CLASSES = room_classes()


def off(pose: Pose2D, other: Pose2D) -> tuple[float, float, float]:
    turned_rad = math.remainder(pose.yaw_rad - other.yaw_rad, math.tau)
    return pose.x_m - other.x_m, pose.y_m - other.y_m, turned_rad


def anywhere(_frame: MapFrame, _pose: Pose2D) -> bool:
    return True


class Scene:
    """A robot r1 on the floor ROOM."""

    def __init__(self) -> None:
        self.atlas = SubmapAtlas(WIDE)
        self.graph = SubmapGraph("r1", GraphSpec())
        self.own = OwnSubmaps(WIDE, self.graph, SubmapSpec())
        self.mates: dict[MapFrame, list[tuple[float, float, float]]] = {}
        self.strangers = 0
        """Mates that are heard, but tell no place in any of these frames."""
        self.frames = Frames("r1", self.atlas, self.graph, self.own, self._robot_places_in, self._received)

    def _robot_places_in(self, frame: MapFrame) -> np.ndarray:
        return np.array(self.mates.get(frame, [])).reshape(-1, 3)

    def _received(self) -> int:
        return self.strangers + sum(map(len, self.mates.values()))

    def map(self, number: int, *places: Pose2D, T_own_floor: Pose2D = T_OWN_FLOOR, trajectory: int = 1) -> None:
        """Make a submap of scans from these places of the floor."""
        if trajectory != self.own.trajectory:
            self.own.begin_trajectory(trajectory)
            self.frames.begin(number, WHY if trajectory else "")
        self.own.begin_submap(number, T_own_floor.compose(places[0]), NO_DRIFT, SURE)
        for place in places:
            ranges_m = ROOM.ranges_m(place)
            self.own.integrate(T_own_floor.compose(place), ANGLES_RAD, ranges_m, RANGE_M, number, NOBODY, NO_DRIFT)
        patch = self.own.pop_patch()
        assert patch is not None
        self.atlas.move(("r1", number), self.own.T_arena_local, self.own.frame)
        self.atlas.merge(("r1", number), patch.cells.row, patch.cells.column, patch.cells.cells, patch.cells.stamp_ms)

    def mates_map(self, frame: MapFrame = ARENA, place: Pose2D = IDENTITY, number: int = 7) -> None:
        self.atlas.move(("r2", number), place, frame)
        self.atlas.merge(("r2", number), 0, 0, ROOM_CLASSES, 5)

    def search(self, at: Pose2D, may_be_at: Callable[[MapFrame, Pose2D], bool] = anywhere) -> bool:
        """Search from a place of the floor; whether the robot has moved into another frame."""
        before = self.frames.frame
        self.frames.search(T_OWN_FLOOR.compose(at), may_be_at)
        return self.frames.frame != before


def lost(*, mates: MapFrame | None = ARENA) -> Scene:
    """It has mapped the room in a frame of its own; a mate has in another one."""
    scene = Scene()
    scene.map(20, *PLACES)
    if mates is not None:
        scene.mates_map(mates)
    return scene
