"""How sure the robot was of its place when it mapped what it now matches its scans against.

A map that was made half a metre off brings every later scan half a metre off: matching makes the robot sure of its
place on the map, not of the map's place in the arena. The exact way is to keep the poses that the map was made from as
states, as SLAM does. Here their variances are remembered, coarsely: x, y and yaw at the first visit of each tile of
the floor.
"""

import math

from robrain.protocol.model.geometry import Pose2D

TILE_M = 2.0
TILES_MAX = 4096
"""16 384 m²; what was entered first is forgotten first."""

Variances = tuple[float, float, float]
"""Of x, y (m²) and yaw (rad²)."""
NONE: Variances = (0.0, 0.0, 0.0)


class MapAnchors:
    """Variances of the map's place in the arena, tile by tile of `TILE_M`.

    Args:
        step_m: standard deviation that each new tile adds: in which part of its cell a wall lies is not seen.
        step_rad: what it adds to the yaw.

    """

    def __init__(self, step_m: float, step_rad: float) -> None:
        self._step: Variances = (step_m**2, step_m**2, step_rad**2)
        self._tiles: dict[tuple[int, int], Variances] = {}

    def __len__(self) -> int:
        return len(self._tiles)

    def at(self, pose: Pose2D) -> Variances | None:
        """Those of the tile; None if the robot has never mapped from there."""
        return self._tiles.get(_tile(pose))

    def enter(self, pose: Pose2D, variances: Variances) -> Variances:
        """Those of the tile; at the first visit they are the robot's own, and a step more."""
        tile = _tile(pose)
        known = self._tiles.get(tile)
        if known is not None:
            return known
        if len(self._tiles) >= TILES_MAX:
            del self._tiles[next(iter(self._tiles))]
        x, y, yaw = variances
        step_x, step_y, step_yaw = self._step
        self._tiles[tile] = fresh = (x + step_x, y + step_y, yaw + step_yaw)
        return fresh


def _tile(pose: Pose2D) -> tuple[int, int]:
    return math.floor(pose.x_m / TILE_M), math.floor(pose.y_m / TILE_M)
