"""What `match_surface` promises of the place that it finds, computed plainly: the definition, beam by beam."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.mapping.occupancy_grid import HIT_DEPTH_CELLS, OccupancyGrid
from robrain.protocol.model.geometry import Pose2D

Floats = NDArray[np.float64]
REACH_CELLS, AROUND_CELLS = 1.5, 2
OPPOSITE = -0.8
HUBER_CELLS = 0.3
FIT_CELLS = 2.0


class Line(NamedTuple):
    """A wall near a beam's end, in cells."""

    point: Floats
    normal: Floats


class Lies(NamedTuple):
    """How a scan lies: `information` and `pull` (toward the optimum) of x, y, in cells, and yaw · lever."""

    information: Floats
    pull: Floats
    used: int
    lever: float


def _walls(grid: OccupancyGrid, row: int, column: int, around: int) -> list[tuple[int, int]]:
    height, width = grid.log_odds.shape
    return [
        (i, j)
        for i in range(row - around, row + around + 1)
        for j in range(column - around, column + around + 1)
        if 0 <= i < height and 0 <= j < width and grid.log_odds[i, j] > 0 and grid.surfaces.hits[i, j] > 0
    ]


def line_near(grid: OccupancyGrid, end: Floats, beam: Floats) -> Line | None:
    """The wall on which a beam's end is laid, if there is one."""
    column, row = np.floor(end + HIT_DEPTH_CELLS * beam).astype(int)
    if not grid.geometry.contains(row, column):
        return None
    at, view = grid.surfaces.at.astype(float), grid.surfaces.seen_along.astype(float)
    facing = [cell for cell in _walls(grid, row, column, AROUND_CELLS) if view[cell] @ beam > OPPOSITE]
    near = [cell for cell in facing if math.dist(at[cell], end) < REACH_CELLS]
    if not near:
        return None
    best = min(near, key=lambda cell: math.dist(at[cell], end))
    for spread in (1, 2, 3, 4):
        cells = [cell for cell in _walls(grid, *best, spread) if view[cell] @ view[best] > OPPOSITE]
        if len(cells) >= 3:
            break
    else:
        return None
    places = np.array([at[cell] for cell in cells])
    hits = [min(int(grid.surfaces.hits[cell]), 8) for cell in cells]
    values, vectors = np.linalg.eigh(np.cov(places.T, aweights=hits, bias=True))
    if values[0] > 0.15 * values[1]:
        return None
    normal = vectors[:, 0]
    if (normal @ view[best]) * (normal @ beam) <= 0:
        return None
    return Line(np.average(places, axis=0, weights=hits), normal)


def lies(grid: OccupancyGrid, sensor: Pose2D, points: Floats) -> Lies:
    """Information and pull of a scan whose sensor is there."""
    per_m = 1.0 / grid.geometry.resolution_m
    lever = per_m * math.sqrt(float(np.mean(np.sum(points**2, axis=1))))
    ends, outs = _ends(grid, sensor, points)
    information, pull, used = np.zeros((3, 3)), np.zeros(3), 0
    for end, out in zip(ends, outs, strict=True):
        line = line_near(grid, end, out / np.linalg.norm(out))
        if line is None:
            continue
        used += 1
        off = float(line.normal @ (end - line.point))
        row = np.array((*line.normal, (line.normal[1] * out[0] - line.normal[0] * out[1]) / lever))
        weight = min(1.0, HUBER_CELLS / max(abs(off), 1e-12))
        information += weight * np.outer(row, row)
        pull -= weight * off * row
    return Lies(information, pull, used, lever)


def fit_of(grid: OccupancyGrid, sensor: Pose2D, points: Floats) -> tuple[float, int, float, float]:
    """Share of beams that end near a wall, how many end where the map is known, mean drift of the walls (m², rad²)."""
    at = grid.surfaces.at.astype(float)
    known, drifts = 0, []
    for end in _ends(grid, sensor, points)[0]:
        column, row = np.floor(end).astype(int)
        if not grid.geometry.contains(row, column):
            continue
        near = [cell for cell in _walls(grid, row, column, 2) if math.dist(at[cell], end) <= FIT_CELLS]
        if near:
            drifts.append(grid.surfaces.drift[min(near, key=lambda cell: math.dist(at[cell], end))])
        known += bool(near) or grid.log_odds[row, column] != 0
    m2, rad2 = np.mean(drifts, axis=0).tolist() if drifts else (0.0, 0.0)
    return len(drifts) / max(known, 1), known, m2, rad2


def _ends(grid: OccupancyGrid, sensor: Pose2D, points: Floats) -> tuple[Floats, Floats]:
    """Ends of the beams in cells from the grid's origin, and seen from the sensor."""
    per_m = 1.0 / grid.geometry.resolution_m
    cos, sin = math.cos(sensor.yaw_rad), math.sin(sensor.yaw_rad)
    outs = per_m * points @ np.array([[cos, sin], [-sin, cos]])
    origin = np.array((sensor.x_m - grid.geometry.origin_x_m, sensor.y_m - grid.geometry.origin_y_m))
    return per_m * origin + outs, outs
