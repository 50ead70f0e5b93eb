"""Placement of robots and motes on a floor plan."""

import heapq
import math
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robrain.protocol.model.geometry import Point2D, Pose2D, wrap_angle_rad
from robrain.sim.maps.floor_plan import FloorPlan, PlacementError

SPAWN_MARGIN_M = 0.05
USUAL_TEAM = 4
"""Robots for which there is room at the spot that is drawn, so that a team of any size starts around the same one."""

# Mitchell 1991 draws candidates in proportion to the samples that there are, so that the spectrum stays the same.
CANDIDATES_PER_POINT = 10
SPACING_RELAXATION = 0.8

_SQRT2 = math.sqrt(2)
_STEPS = (
    (-1, 0, 1.0), (0, -1, 1.0), (0, 1, 1.0), (1, 0, 1.0),
    (-1, -1, _SQRT2), (-1, 1, _SQRT2), (1, -1, _SQRT2), (1, 1, _SQRT2),
)  # fmt: skip


class Starts(StrEnum):
    """Relative placement of a team's robots when a run begins."""

    TOGETHER = "together"
    SCATTERED = "scattered"
    """Far from each other, all over the floor that the robots can reach."""


def spawn_poses(
    plan: FloorPlan, count: int, radius_m: float, *, near: Point2D | None, rng: np.random.Generator, spacing_m: float
) -> list[Pose2D]:
    """`count` poses close together for round robots of radius_m: arena frame, yaw drawn at random.

    All lie in one region that such a robot can roam, with radius_m + SPAWN_MARGIN_M of clearance and spacing_m
    between centres. With `near`, it is the region nearest to that point and the group gathers about it. Without, it
    is the largest region and the group gathers at a spot with room for `USUAL_TEAM` robots, the same for all counts.
    The same arguments and generator state give the same poses. Raises PlacementError if fewer places are found than
    asked for, or `near` is off the map.
    """
    fitting = ~plan.occupied & (plan.clearance_m >= radius_m + SPAWN_MARGIN_M)
    if not fitting.any():
        raise PlacementError(f"{plan.name}: no free space for {count} robots of radius {radius_m:g} m, none fits")
    if near is None:
        region = _roomiest_region(fitting)
        anchor = _spot_with_room(plan, region, radius_m + spacing_m * math.sqrt(USUAL_TEAM) / 2, rng)
    else:
        if not plan.geometry.contains(*plan.geometry.cell_of(near.x_m, near.y_m)):
            raise PlacementError(
                f"{plan.name}: expected a start on the map, {_extent(plan)}; got {near.x_m:g}, {near.y_m:g}"
            )
        anchor = _nearest_cell(plan, fitting, near)
        labels, _ = ndimage.label(fitting)
        region = labels == labels[anchor]
    cells = _gather(region, anchor, count, spacing_m / plan.resolution_m)
    if len(cells) < count:
        raise PlacementError(
            f"{plan.name}: {count} robots of radius {radius_m:g} m asked for at {spacing_m:g} m spacing, "
            f"{len(cells)} fit"
        )
    points = [plan.geometry.center_of(*cell) for cell in cells]
    return [Pose2D(point.x_m, point.y_m, wrap_angle_rad(float(rng.uniform(-math.pi, math.pi)))) for point in points]


def scatter_poses(
    plan: FloorPlan, count: int, radius_m: float, *, rng: np.random.Generator, spacing_m: float
) -> list[Pose2D]:
    """`count` poses far from each other for round robots of radius_m: arena frame, yaw drawn at random.

    All lie in the largest region that such a robot can roam. Raises PlacementError if they do not fit there.
    """
    clearance_m = radius_m + SPAWN_MARGIN_M
    fitting = ~plan.occupied & (plan.clearance_m >= clearance_m)
    region = _roomiest_region(fitting) if fitting.any() else fitting
    apart_m = max(spacing_m, 0.7 * math.sqrt(float(region.sum()) * plan.resolution_m**2 / max(count, 1)))
    points = scatter_points(plan, count, region, rng=rng, min_clearance_m=clearance_m, spacing_m=apart_m)
    nearest_m = min((a.distance_m(b) for i, a in enumerate(points) for b in points[:i]), default=math.inf)
    if nearest_m < spacing_m:
        raise PlacementError(
            f"{plan.name}: {count} scattered robots of radius {radius_m:g} m asked for at {spacing_m:g} m spacing, "
            f"two would be {nearest_m:.2f} m apart"
        )
    return [Pose2D(point.x_m, point.y_m, wrap_angle_rad(float(rng.uniform(-math.pi, math.pi)))) for point in points]


def scatter_points(
    plan: FloorPlan,
    count: int,
    region_mask: NDArray[np.bool_],
    *,
    rng: np.random.Generator,
    min_clearance_m: float,
    spacing_m: float,
) -> list[Point2D]:
    """`count` points spread evenly over the cells of region_mask (H, W): cell centres, metres, arena frame.

    Best-candidate sampling (Mitchell, "Spectrally optimal sampling for distribution ray tracing", SIGGRAPH 1991): of
    many candidates, the one farthest from all points so far. Each has min_clearance_m to the nearest wall; points are
    spacing_m apart, less where that many do not fit otherwise. Same arguments and generator state, same points.
    Raises PlacementError if there are fewer cells than points.
    """
    cells = np.argwhere(region_mask & ~plan.occupied & (plan.clearance_m >= min_clearance_m))
    if len(cells) < count:
        raise PlacementError(
            f"{plan.name}: {count} points asked for with {min_clearance_m:g} m of clearance, {len(cells)} fit"
        )
    apart_m = np.full(len(cells), np.inf)
    chosen: list[int] = []
    while len(chosen) < count:
        eligible = np.flatnonzero(apart_m >= spacing_m)
        while not len(eligible):
            spacing_m = _relaxed(spacing_m, plan.resolution_m)
            eligible = np.flatnonzero((apart_m >= spacing_m) & (apart_m > 0))
        candidates = eligible[rng.integers(len(eligible), size=CANDIDATES_PER_POINT * (len(chosen) + 1))]
        best = int(candidates[np.argmax(apart_m[candidates])])
        chosen.append(best)
        offset = (cells - cells[best]) * plan.resolution_m
        apart_m = np.minimum(apart_m, np.hypot(offset[:, 0], offset[:, 1]))
    return [plan.geometry.center_of(int(row), int(col)) for row, col in cells[chosen]]


def _relaxed(spacing_m: float, resolution_m: float) -> float:
    # Below a cell's pitch every cell that holds no point is far enough.
    return spacing_m * SPACING_RELAXATION if spacing_m > resolution_m else 0.0


def _roomiest_region(fitting: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W), the largest connected region of `fitting` cells.

    On every real map that was tried this is the inside of a building, and the path between the rocks of a cave.
    """
    labels, region_count = ndimage.label(fitting)
    area = np.bincount(labels.ravel(), minlength=region_count + 1)[1:]
    return np.asarray(labels == int(np.argmax(area)) + 1)


def _spot_with_room(
    plan: FloorPlan, region: NDArray[np.bool_], room_m: float, rng: np.random.Generator
) -> tuple[int, int]:
    clearance_m = np.where(region, plan.clearance_m, 0.0)
    spots = np.argwhere(clearance_m >= min(room_m, float(clearance_m.max())))
    row, col = spots[rng.integers(len(spots))]
    return int(row), int(col)


def _extent(plan: FloorPlan) -> str:
    rows, columns = plan.occupied.shape
    x_m, y_m = plan.origin_x_m + columns * plan.resolution_m, plan.origin_y_m + rows * plan.resolution_m
    return f"x from {plan.origin_x_m:g} to {x_m:g} m and y from {plan.origin_y_m:g} to {y_m:g} m"


def _nearest_cell(plan: FloorPlan, fitting: NDArray[np.bool_], near: Point2D) -> tuple[int, int]:
    cells = np.argwhere(fitting)
    row, col = (near.y_m - plan.origin_y_m) / plan.resolution_m, (near.x_m - plan.origin_x_m) / plan.resolution_m
    nearest = int(np.argmin(np.hypot(cells[:, 0] + 0.5 - row, cells[:, 1] + 0.5 - col)))
    return int(cells[nearest, 0]), int(cells[nearest, 1])


def _gather(
    region: NDArray[np.bool_], anchor: tuple[int, int], count: int, spacing_cells: float
) -> list[tuple[int, int]]:
    """Up to `count` cells of the region by path length from the anchor, each spacing_cells from the others.

    Dijkstra (1959) over 8-neighbours: by path length, not straight-line distance, so that no team starts on both sides
    of a wall.
    """
    rows, cols = region.shape
    waiting = region.copy()
    apart = np.ones_like(region)
    length_to = {anchor: 0.0}
    queue = [(0.0, anchor)]
    chosen_cells: list[tuple[int, int]] = []
    while queue and len(chosen_cells) < count:
        length, (row, col) = heapq.heappop(queue)
        if not waiting[row, col]:
            continue
        waiting[row, col] = False
        if apart[row, col]:
            chosen_cells.append((row, col))
            _clear_disc(apart, row, col, spacing_cells)
        for row_step, col_step, step_length in _STEPS:
            cell = (row + row_step, col + col_step)
            if not (0 <= cell[0] < rows and 0 <= cell[1] < cols and waiting[cell]):
                continue
            if length + step_length < length_to.get(cell, math.inf):
                length_to[cell] = length + step_length
                heapq.heappush(queue, (length_to[cell], cell))
    return chosen_cells


def _clear_disc(mask: NDArray[np.bool_], row: int, col: int, radius_cells: float) -> None:
    """Clears the cells nearer than radius_cells to (row, col), centre to centre."""
    reach = math.ceil(radius_cells)
    row0, col0 = max(0, row - reach), max(0, col - reach)
    window = mask[row0 : row + reach + 1, col0 : col + reach + 1]
    row_offset = np.arange(row0, row0 + window.shape[0])[:, np.newaxis] - row
    col_offset = np.arange(col0, col0 + window.shape[1])[np.newaxis, :] - col
    # A spacing that is a whole number of cells counts as kept.
    window &= np.hypot(row_offset, col_offset) >= radius_cells - 1e-9
