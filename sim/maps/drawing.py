"""Floor plans drawn with walls, blocks and pillars: the table `[floor]` of a scenario.

Lengths are metres in the arena frame, whose origin is the floor's corner with the lowest x and y.
"""

import math

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive
from robrain.recording.errors import MapError
from robrain.recording.reader.map_server import MAX_CELLS, size_refusal
from robrain.sim.maps.floor_plan import FloorPlan

BOUNDARY_THICKNESS_M = 0.1

# A shape covers the cells whose centre it holds, edges with the lower coordinate included; the slack keeps decimal
# fractions that meet a centre exactly from falling on either side by rounding.
_SLACK_M = 1e-9


class Wall(Checked, frozen=True, forbid_unknown_fields=True):
    """A straight wall: a thick segment, longer by half its thickness at both ends, so that corners close."""

    from_m: tuple[float, float]
    """One end: x and y."""
    to_m: tuple[float, float]
    """The other end."""
    thickness_m: Positive = 0.15


class Block(Checked, frozen=True, forbid_unknown_fields=True):
    """A shelf or a machine: a rectangle along the axes."""

    x_m: float
    """Lowest x."""
    y_m: float
    """Lowest y."""
    width_m: Positive
    """Extent along x."""
    height_m: Positive
    """Extent along y."""


class Pillar(Checked, frozen=True, forbid_unknown_fields=True):
    """A disc."""

    x_m: float
    """x of its centre."""
    y_m: float
    """y of its centre."""
    radius_m: Positive


class FloorDrawing(Checked, frozen=True, forbid_unknown_fields=True):
    """A floor plan drawn with walls, blocks and pillars; the outer walls are added.

    Raises ValueError that names the key: for a length that is not above 0, a shape outside the floor, or more than
    MAX_CELLS cells.
    """

    size_m: tuple[Positive, Positive]
    """Width along x and height along y."""
    resolution_m: Positive = 0.05
    """Side of a cell."""
    walls: tuple[Wall, ...] = ()
    blocks: tuple[Block, ...] = ()
    pillars: tuple[Pillar, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        width_m, height_m = self.size_m
        if width_m * height_m / self.resolution_m**2 > MAX_CELLS:
            raise MapError(f"expected resolution_m for at most {MAX_CELLS} cells, got {self.resolution_m}")
        if reason := size_refusal(width_m, height_m):
            raise MapError(f"size_m: {reason}")
        for index, wall in enumerate(self.walls):
            self._check_inside(f"walls[{index}].from_m", *wall.from_m)
            self._check_inside(f"walls[{index}].to_m", *wall.to_m)
            if wall.from_m == wall.to_m:
                raise MapError(f"expected walls[{index}].to_m different from from_m, got {list(wall.to_m)} for both")
        for index, block in enumerate(self.blocks):
            self._check_inside(f"blocks[{index}]", block.x_m, block.y_m)
            self._check_inside(f"blocks[{index}]", block.x_m + block.width_m, block.y_m + block.height_m)
        for index, pillar in enumerate(self.pillars):
            self._check_inside(f"pillars[{index}]", pillar.x_m, pillar.y_m)

    def _check_inside(self, key: str, x_m: float, y_m: float) -> None:
        width_m, height_m = self.size_m
        if not (-_SLACK_M <= x_m <= width_m + _SLACK_M and -_SLACK_M <= y_m <= height_m + _SLACK_M):
            raise MapError(f"expected {key} on the floor of {width_m:g} × {height_m:g} m, got x {x_m:g}, y {y_m:g}")


def rasterise(drawing: FloorDrawing, name: str) -> FloorPlan:
    """Draw the plan on a grid with its origin at (0, 0), closed by a wall of BOUNDARY_THICKNESS_M inside its edge.

    A size that is not a whole number of cells is rounded up. A wall is at least a cell's diagonal wide, so that it has
    no gaps. Raises MapError if no free cell is left.
    """
    width_m, height_m = drawing.size_m
    resolution_m = drawing.resolution_m
    cols = math.ceil(width_m / resolution_m - 1e-6)
    rows = math.ceil(height_m / resolution_m - 1e-6)
    x_m = _centres_m(cols, resolution_m)[np.newaxis, :]
    y_m = _centres_m(rows, resolution_m)[:, np.newaxis]

    boundary_cells = max(1, math.ceil(BOUNDARY_THICKNESS_M / resolution_m - 1e-6))
    occupied = np.ones((rows, cols), dtype=np.bool_)
    occupied[boundary_cells:-boundary_cells, boundary_cells:-boundary_cells] = False
    for wall in drawing.walls:
        occupied |= _wall_cells(wall, x_m, y_m, resolution_m)
    for block in drawing.blocks:
        along_x = _between(x_m, block.x_m, block.x_m + block.width_m)
        along_y = _between(y_m, block.y_m, block.y_m + block.height_m)
        occupied |= along_x & along_y
    for pillar in drawing.pillars:
        occupied |= np.hypot(x_m - pillar.x_m, y_m - pillar.y_m) <= pillar.radius_m + _SLACK_M
    if occupied.all():
        raise MapError(f"{name}: expected free space on the floor of size_m, got none")
    return FloorPlan(occupied, resolution_m, 0.0, 0.0, name)


def _centres_m(count: int, resolution_m: float) -> NDArray[np.float64]:
    return (np.arange(count, dtype=np.float64) + 0.5) * np.float64(resolution_m)


def _wall_cells(
    wall: Wall, x_m: NDArray[np.float64], y_m: NDArray[np.float64], resolution_m: float
) -> NDArray[np.bool_]:
    (from_x_m, from_y_m), (to_x_m, to_y_m) = wall.from_m, wall.to_m
    length_m = math.hypot(to_x_m - from_x_m, to_y_m - from_y_m)
    cos, sin = (to_x_m - from_x_m) / length_m, (to_y_m - from_y_m) / length_m
    half_m = max(wall.thickness_m, math.sqrt(2) * resolution_m) / 2
    along_m = (x_m - from_x_m) * cos + (y_m - from_y_m) * sin
    across_m = (y_m - from_y_m) * cos - (x_m - from_x_m) * sin
    return _between(along_m, -half_m, length_m + half_m) & _between(across_m, -half_m, half_m)


def _between(value_m: NDArray[np.float64], low_m: float, high_m: float) -> NDArray[np.bool_]:
    return (value_m >= low_m - _SLACK_M) & (value_m < high_m - _SLACK_M)
