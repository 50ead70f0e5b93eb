"""How much room there is among points that a robot has seen.

Points are x and y, (2, N). A robot that navigates passes an array, and the functions are compiled. Otherwise the points
are two lists, and the same functions run uncompiled. A robot without arrays thus drives by the same rules.
"""

import math
import sys
from collections.abc import Callable
from functools import cache, wraps
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

PASSAGE_BEHIND_M, PASSAGE_AHEAD_M = 0.15, 0.4
"""Points from this far behind the centre to this far ahead count as walls beside the robot. Points beyond an obstacle
straight ahead, such as a teammate, do not count."""
FRONT_M = 0.05
"""Points count as walls up to this far before an obstacle straight ahead: a margin for noise of the lidar."""
SURE_M = 0.03
"""A single point that overlaps the disc's track by more than this is an obstacle. With less overlap, `WITNESSES` points
are needed (chosen: three standard deviations of a lidar's range)."""
WITNESSES = 3
BARRIER_M = 0.2
Function = TypeVar("Function", bound=Callable[..., Any])

if TYPE_CHECKING:
    from robrain.algorithms.numeric.kernel_array import Floats

    Points = tuple[list[float], list[float]] | Floats
    """(2, N): x and y of points, metres."""


def has_arrays() -> bool:
    """Whether this process has loaded the compiler, because it navigates or simulates."""
    return "numba" in sys.modules


def points_of(x_m: list[float], y_m: list[float]) -> "Points":
    """Points with these coordinates."""
    if not has_arrays():
        return x_m, y_m
    import numpy as np

    return np.array((x_m, y_m), dtype=np.float64)


def joined(first: "Points", second: "Points") -> "Points":
    """The points of both."""
    if isinstance(first, tuple) and isinstance(second, tuple):
        return first[0] + second[0], first[1] + second[1]
    import numpy as np

    return np.concatenate((first, second), axis=1)


class Passage(NamedTuple):
    """Room in a narrow place ahead, metres; inf where nothing is seen."""

    free_m: float
    """Distance that the disc can go straight ahead before it touches a point."""
    left_m: float
    """From the line along which its centre moves to the nearest wall on the left."""
    right_m: float


@cache
def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    from numba import njit

    compiled: Callable[..., Any] = njit(cache=True, nogil=True)(function)
    return compiled


def _either(function: Function) -> Function:
    """The function, which is compiled where the points are arrays."""

    @wraps(function)
    def call(points_m: "Points", *rest: float) -> Any:
        return (function if isinstance(points_m, tuple) else _compiled(function))(points_m, *rest)

    return cast("Function", call)


@_either
def contact_distance_m(points_m: Any, x_m: float, y_m: float, heading_rad: float, reach_m: float) -> float:
    """How far a disc can go straight ahead before it touches one of the points; inf if it never does.

    The points and the disc's centre x, y are in one frame, in which it goes towards `heading_rad`; `reach_m` is its
    radius. The disc passes points beside or behind it. A point within the disc and ahead of its centre gives a negative
    distance.
    """
    xs_m, ys_m = points_m[0], points_m[1]
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    nearest_m = math.inf
    for index in range(len(xs_m)):
        dx_m, dy_m = xs_m[index] - x_m, ys_m[index] - y_m
        ahead_m = cos * dx_m + sin * dy_m
        if ahead_m <= 0.0:
            continue
        aside_m = cos * dy_m - sin * dx_m
        if abs(aside_m) < reach_m:
            nearest_m = min(nearest_m, ahead_m - math.sqrt(reach_m * reach_m - aside_m * aside_m))
    return nearest_m


@_either
def passage(points_m: Any, x_m: float, y_m: float, heading_rad: float, radius_m: float) -> Passage:
    """The room for a disc that squeezes straight ahead; arguments as for `contact_distance_m`.

    Distances are to the third nearest point instead of the nearest. With walls this near, the noise of a single range
    would close the passage repeatedly.
    """
    xs_m, ys_m = points_m[0], points_m[1]
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    core_m = radius_m - SURE_M
    free_m = math.inf
    # The least distances, sorted: of contacts ahead, walls on the left, walls on the right.
    contacts_m, left_m, right_m = [math.inf] * WITNESSES, [math.inf] * WITNESSES, [math.inf] * WITNESSES
    for index in range(len(xs_m)):
        dx_m, dy_m = xs_m[index] - x_m, ys_m[index] - y_m
        ahead_m = cos * dx_m + sin * dy_m
        aside_m = cos * dy_m - sin * dx_m
        if ahead_m > 0.0 and abs(aside_m) < radius_m:
            distance_m = ahead_m - math.sqrt(radius_m * radius_m - aside_m * aside_m)
            for k in range(WITNESSES):
                if distance_m < contacts_m[k]:
                    contacts_m[k], distance_m = distance_m, contacts_m[k]
            if abs(aside_m) < core_m:
                free_m = min(free_m, ahead_m - math.sqrt(core_m * core_m - aside_m * aside_m))
    free_m = min(free_m, contacts_m[WITNESSES - 1])
    until_m = min(PASSAGE_AHEAD_M, radius_m + max(0.0, free_m) - FRONT_M)
    for index in range(len(xs_m)):
        dx_m, dy_m = xs_m[index] - x_m, ys_m[index] - y_m
        ahead_m = cos * dx_m + sin * dy_m
        aside_m = cos * dy_m - sin * dx_m
        if -PASSAGE_BEHIND_M < ahead_m < until_m and abs(aside_m) > 0.5 * radius_m:
            walls_m = left_m if aside_m > 0.0 else right_m
            distance_m = abs(aside_m)
            for k in range(WITNESSES):
                if distance_m < walls_m[k]:
                    walls_m[k], distance_m = distance_m, walls_m[k]
    return Passage(free_m, left_m[WITNESSES - 1], right_m[WITNESSES - 1])


@_either
def hold_off(
    points_m: Any, x_m: float, y_m: float, x_m_s: float, y_m_s: float, radius_m: float, keep_m: float, per_s: float
) -> tuple[float, float]:
    """The velocity (x, y) changed so that a disc comes no nearer to any point than `keep_m` beyond its radius.

    The disc approaches a point at most at `per_s` times the distance left, and moves away from a point that is too
    near: a control barrier function (Ames et al., *Control Barrier Functions: Theory and Applications*, ECC 2019). The
    excess is subtracted for one point after the other, twice over all points. Other arguments as for
    `contact_distance_m`; points farther than `BARRIER_M` from the hull do not count.
    """
    xs_m, ys_m = points_m[0], points_m[1]
    for _ in range(2):
        for index in range(len(xs_m)):
            dx_m, dy_m = xs_m[index] - x_m, ys_m[index] - y_m
            away_m = math.hypot(dx_m, dy_m)
            if away_m > radius_m + BARRIER_M or away_m < 1e-6:
                continue
            towards_m_s = (x_m_s * dx_m + y_m_s * dy_m) / away_m
            too_fast_m_s = towards_m_s - per_s * (away_m - radius_m - keep_m)
            if too_fast_m_s > 0.0:
                x_m_s -= too_fast_m_s * dx_m / away_m
                y_m_s -= too_fast_m_s * dy_m / away_m
    return x_m_s, y_m_s


@_either
def sector_distances_m(points_m: Any, x_m: float, y_m: float, yaw_rad: float, sectors: int) -> list[float]:
    """Distance (`sectors`,) from a place to the nearest point in each sector; inf for a sector without points.

    Points, place and yaw are in the same frame. Sector 0 is centred on the yaw; the others follow counter-clockwise.
    """
    xs_m, ys_m = points_m[0], points_m[1]
    nearest_m = [math.inf] * sectors
    for index in range(len(xs_m)):
        dx_m, dy_m = xs_m[index] - x_m, ys_m[index] - y_m
        direction_rad = math.atan2(dy_m, dx_m) - yaw_rad
        sector = round(direction_rad * sectors / (2.0 * math.pi)) % sectors
        nearest_m[sector] = min(nearest_m[sector], math.hypot(dx_m, dy_m))
    return nearest_m
