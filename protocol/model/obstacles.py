"""How far a round robot can go, by points that it has seen around it."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def contact_distance_m(
    points_m: NDArray[np.float64],
    x_m: float,
    y_m: float,
    heading_rad: float,
    reach_m: float,
) -> float:
    """How far a disc can go straight ahead before it touches one of the points; inf if it never does.

    `points_m` (2, N) and the disc's centre x, y are in one frame, in which it goes towards `heading_rad`; `reach_m` is
    its radius. What lies beside or behind is passed. A point within the disc and ahead of its centre gives a negative
    distance.
    """
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    nearest_m = math.inf
    for index in range(points_m.shape[1]):
        dx_m, dy_m = points_m[0, index] - x_m, points_m[1, index] - y_m
        ahead_m = cos * dx_m + sin * dy_m
        if ahead_m <= 0.0:
            continue
        aside_m = cos * dy_m - sin * dx_m
        if abs(aside_m) < reach_m:
            nearest_m = min(nearest_m, ahead_m - math.sqrt(reach_m * reach_m - aside_m * aside_m))
    return nearest_m


class Passage(NamedTuple):
    """What a narrow place ahead leaves, metres; inf where nothing is seen."""

    free_m: float
    """How far the disc can go straight ahead before it touches something."""
    left_m: float
    """From the line of its centre to what stands on its left."""
    right_m: float


PASSAGE_BEHIND_M, PASSAGE_AHEAD_M = 0.15, 0.4
"""What stands beside the way from here to there, as seen from the centre, is what a robot squeezes between; what stands
beyond something that is straight ahead, a team mate say, is not."""
FRONT_M = 0.05
"""So much nearer than what is straight ahead is what stands beside the way; some noise of the lidar lies between."""
SURE_M = 0.03
"""A single point deeper than this in the way of the disc is an obstacle; less deep it takes `WITNESSES` (chosen: three
standard deviations of a lidar's range)."""
WITNESSES = 3
BARRIER_M = 0.2


def passage(points_m: NDArray[np.float64], x_m: float, y_m: float, heading_rad: float, radius_m: float) -> Passage:
    """The room that a disc has which squeezes straight ahead; arguments as of `contact_distance_m`.

    It goes by the third nearest point rather than by the nearest: between walls as near as these the noise of a single
    range would shut the way time and again.
    """
    return Passage(*_passage(points_m, x_m, y_m, heading_rad, radius_m))


@njit(cache=True, nogil=True)
def _passage(
    points_m: NDArray[np.float64], x_m: float, y_m: float, heading_rad: float, radius_m: float
) -> tuple[float, float, float]:
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    core_m = radius_m - SURE_M
    free_m = math.inf
    nearest_m = np.full((3, WITNESSES), np.inf)  # contacts ahead, what is on the left, what is on the right
    for index in range(points_m.shape[1]):
        dx_m, dy_m = points_m[0, index] - x_m, points_m[1, index] - y_m
        ahead_m = cos * dx_m + sin * dy_m
        aside_m = cos * dy_m - sin * dx_m
        if ahead_m > 0.0 and abs(aside_m) < radius_m:
            _keep_nearest(nearest_m[0], ahead_m - math.sqrt(radius_m * radius_m - aside_m * aside_m))
            if abs(aside_m) < core_m:
                free_m = min(free_m, ahead_m - math.sqrt(core_m * core_m - aside_m * aside_m))
    last = WITNESSES - 1
    free_m = min(free_m, nearest_m[0, last])
    until_m = min(PASSAGE_AHEAD_M, radius_m + max(0.0, free_m) - FRONT_M)
    for index in range(points_m.shape[1]):
        dx_m, dy_m = points_m[0, index] - x_m, points_m[1, index] - y_m
        ahead_m = cos * dx_m + sin * dy_m
        aside_m = cos * dy_m - sin * dx_m
        if -PASSAGE_BEHIND_M < ahead_m < until_m and abs(aside_m) > 0.5 * radius_m:
            _keep_nearest(nearest_m[1 if aside_m > 0.0 else 2], abs(aside_m))
    return free_m, nearest_m[1, last], nearest_m[2, last]


@njit(cache=True, nogil=True)
def _keep_nearest(nearest_m: NDArray[np.float64], distance_m: float) -> None:
    """Put a distance among the least ones, which are in order."""
    for k in range(nearest_m.shape[0]):
        if distance_m < nearest_m[k]:
            nearest_m[k], distance_m = distance_m, nearest_m[k]


@njit(cache=True, nogil=True)
def hold_off(
    points_m: NDArray[np.float64],
    x_m: float,
    y_m: float,
    x_m_s: float,
    y_m_s: float,
    radius_m: float,
    keep_m: float,
    per_s: float,
) -> tuple[float, float]:
    """A velocity (x, y) with which a disc does not come nearer to any point than `keep_m` beyond its radius.

    Towards a point it goes no faster than `per_s` times what is left until then, and away from one that is nearer: a
    control barrier function (Ames et al., *Control Barrier Functions: Theory and Applications*, ECC 2019). What goes
    too fast towards one is taken out of the velocity, in turn for all points, twice. Arguments otherwise as of
    `contact_distance_m`; nothing farther than `BARRIER_M` from the hull counts.
    """
    for _ in range(2):
        for index in range(points_m.shape[1]):
            dx_m, dy_m = points_m[0, index] - x_m, points_m[1, index] - y_m
            away_m = math.hypot(dx_m, dy_m)
            if away_m > radius_m + BARRIER_M or away_m < 1e-6:
                continue
            towards_m_s = (x_m_s * dx_m + y_m_s * dy_m) / away_m
            too_fast_m_s = towards_m_s - per_s * (away_m - radius_m - keep_m)
            if too_fast_m_s > 0.0:
                x_m_s -= too_fast_m_s * dx_m / away_m
                y_m_s -= too_fast_m_s * dy_m / away_m
    return x_m_s, y_m_s


@njit(cache=True, nogil=True)
def sector_distances_m(
    points_m: NDArray[np.float64],
    x_m: float,
    y_m: float,
    yaw_rad: float,
    sectors: int,
) -> NDArray[np.float64]:
    """Distance (`sectors`,) from a place to the nearest point in each of these sectors; inf where there is none.

    `points_m` (2, N), x, y and the yaw are in one frame. Sector 0 is centred on the yaw, the others follow
    counter-clockwise.
    """
    nearest_m = np.full(sectors, np.inf)
    for index in range(points_m.shape[1]):
        dx_m, dy_m = points_m[0, index] - x_m, points_m[1, index] - y_m
        direction_rad = math.atan2(dy_m, dx_m) - yaw_rad
        sector = round(direction_rad * sectors / (2.0 * math.pi)) % sectors
        nearest_m[sector] = min(nearest_m[sector], math.hypot(dx_m, dy_m))
    return nearest_m
