"""How far a round robot can go, by points that it has seen around it."""

import math

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
