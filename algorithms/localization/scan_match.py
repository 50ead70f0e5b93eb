"""Where a scan fits on the map: Gauss–Newton on the distance to the nearest wall, and a search over a window.

The refinement is that of Kohlbrecher et al., *A flexible and scalable SLAM system with full 3D motion estimation*, SSRR
2011, on a distance field in place of occupancy; the search is that of Olson, *Real-time correlative scan matching*,
ICRA 2009, at one resolution. Directions in which the walls say nothing, as along a corridor, are found by the
eigenvalues of the information and left as they were (Zhang, Kaess, Singh, *On degeneracy of optimization-based state
estimation problems*, ICRA 2016).
"""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.localization import scan_match_kernels as kernels
from robrain.algorithms.mapping.occupancy_kernels import HIT_DEPTH_CELLS
from robrain.algorithms.numeric.kernel_array import FLOAT64, Floats, kernel_array
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

REACH_M = 0.4
"""A beam that ends farther from all walls than this says nothing to the refinement."""
DEGENERATE = 0.08
"""A direction with less than this share of the information that each beam could give is not believed; chosen."""
BEAMS_MIN = 20
SEARCH_STEP_RAD = 0.035
AMBIGUOUS = 0.75
"""A second place that fits this well, compared with the best, makes a search's answer worthless."""
APART_M, APART_RAD = 0.5, 0.25
"""What lies farther from the best than this is another place."""


class Direction(msgspec.Struct, frozen=True):
    """One direction of (x, y, yaw) in which walls hold the robot: row · (true pose − guess) = offset_m."""

    row: tuple[float, float, float]
    offset_m: float
    information: float
    """Sum over the beams of how much each moves along its wall's normal with this direction: 0 to their number."""


class ScanFit(msgspec.Struct, frozen=True):
    """How a scan lies on a map."""

    directions: list[Direction]
    """Those that are held; at most three, at right angles once yaw is counted in metres at the mean range."""
    fit: float
    """Share of the compared beams that end within 0.2 m of a wall of the map, at the place found; 0 if there are
    none."""
    beams: int
    """Beams that end where the map is known."""


def match_scan(
    log_odds: NDArray[np.int8], geometry: GridGeometry, guess: Pose2D, points: Floats, reach_m: float = REACH_M
) -> ScanFit:
    """Refine a guess that is wrong by less than `reach_m`; beams that end farther from all walls are ignored.

    `log_odds` (H, W) is an `OccupancyGrid`'s; `guess` is T_arena_sensor; `points` are a scan's, see `beam_ends`. Raises
    ValueError for a map that does not fit its geometry.
    """
    return match_walls(log_odds, geometry, guess, _in_walls(points, geometry), reach_m)


def match_walls(
    log_odds: NDArray[np.int8], geometry: GridGeometry, guess: Pose2D, walls: Floats, reach_m: float = REACH_M
) -> ScanFit:
    """As `match_scan`, with the middles (K, 2) of a map's occupied cells in place of the ends of beams."""
    _check(log_odds, geometry)
    found, held, fit, beams = kernels.refine(
        log_odds,
        1.0 / geometry.resolution_m,
        geometry.origin_x_m,
        geometry.origin_y_m,
        guess.x_m,
        guess.y_m,
        guess.yaw_rad,
        walls,
        reach_m,
        DEGENERATE,
        BEAMS_MIN,
    )
    directions = [Direction((a, b, c), offset_m, held_by) for a, b, c, offset_m, held_by in found[:held].tolist()]
    return ScanFit(directions, fit, beams)


def search_scan(
    log_odds: NDArray[np.int8],
    geometry: GridGeometry,
    guess: Pose2D,
    points: Floats,
    *,
    within_m: float,
    within_rad: float,
    fit_min: float = 0.7,
) -> Pose2D | None:
    """Look for the scan's place all around a guess; None if nothing fits well, or more than one place does.

    Arguments are as for `match_scan`. The answer is right to a cell and `SEARCH_STEP_RAD`: refine it.
    """
    _check(log_odds, geometry)
    if len(points) < BEAMS_MIN:
        return None
    steps, turns = math.ceil(within_m / geometry.resolution_m), math.ceil(within_rad / SEARCH_STEP_RAD)
    turn, column, row, best, second = kernels.search(
        log_odds,
        1.0 / geometry.resolution_m,
        geometry.origin_x_m,
        geometry.origin_y_m,
        guess.x_m,
        guess.y_m,
        guess.yaw_rad,
        _in_walls(points, geometry),
        steps,
        turns,
        SEARCH_STEP_RAD,
        math.ceil(APART_M / geometry.resolution_m),
        math.ceil(APART_RAD / SEARCH_STEP_RAD),
    )
    if best < fit_min * len(points) or second > AMBIGUOUS * best:
        return None
    return Pose2D(
        guess.x_m + column * geometry.resolution_m,
        guess.y_m + row * geometry.resolution_m,
        math.remainder(guess.yaw_rad + turn * SEARCH_STEP_RAD, math.tau),
    )


def points_in_view(log_odds: NDArray[np.int8], geometry: GridGeometry, sensor: Pose2D, points: Floats) -> Floats:
    """The points just behind free floor of the map: those at walls that the map shows from the same side.

    Other beams ended at something that the map does not have, or at the far side of a wall. Arguments are as for
    `match_scan`.
    """
    per_m = 1.0 / geometry.resolution_m
    x, y = (sensor.x_m - geometry.origin_x_m) * per_m, (sensor.y_m - geometry.origin_y_m) * per_m
    seen: Floats = points[kernels.in_view(log_odds, x, y, sensor.yaw_rad, per_m, points)]
    return seen


def beam_ends(angles_rad: Floats, ranges_m: Floats, range_max_m: float) -> Floats:
    """(K, 2): where the beams (N,) of a scan ended, in the sensor's frame, metres.

    Ranges of `range_max_m` or more, or not above 0, ended nowhere. Raises ValueError for arrays that do not fit.
    """
    if angles_rad.shape != ranges_m.shape or angles_rad.ndim != 1:
        raise ValueError(f"expected (N,) angles and ranges, got {angles_rad.shape} and {ranges_m.shape}")
    hit = (ranges_m > 0) & (ranges_m < range_max_m)
    reached_m, directions_rad = ranges_m[hit], angles_rad[hit]
    points = np.empty((len(reached_m), 2))
    np.multiply(reached_m, np.cos(directions_rad), out=points[:, 0])
    np.multiply(reached_m, np.sin(directions_rad), out=points[:, 1])
    return points


def without_dropouts(ranges_m: Floats, range_max_m: float, misses_min: int) -> Floats:
    """The ranges (N,) of a scan; where fewer than `misses_min` neighbouring beams have no return, they are NaN.

    Black or wet surfaces return single beams or none at random: that is no sign that the way is free. Where it is, many
    neighbouring beams have no return. The first and the last beam count as neighbours.
    """
    heard_m: Floats = kernels.without_dropouts(kernel_array(ranges_m, FLOAT64), range_max_m, misses_min)
    return heard_m


def _in_walls(points: Floats, geometry: GridGeometry) -> Floats:
    """The beams' ends as deep in the walls as the mapper marks them: on average a cell's middle is where they end."""
    ranges_m = np.hypot(points[:, 0], points[:, 1])
    deeper: Floats = points * (1.0 + HIT_DEPTH_CELLS * geometry.resolution_m / ranges_m)[:, None]
    return deeper


def _check(log_odds: NDArray[np.int8], geometry: GridGeometry) -> None:
    if log_odds.shape != geometry.shape:
        raise ValueError(f"expected a map of shape {geometry.shape}, got {log_odds.shape}")
