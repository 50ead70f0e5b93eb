"""Where a scan lies on a submap: the search for loop closures.

A scan is laid on another submap where the robot believes to be (Olson, *Real-time correlative scan matching*, ICRA
2009, where the belief is unsure; then Gauss–Newton). It counts only if the submap knows the place, most beams are as
the submap says, and no other place does as well.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.submap import Submap
from robrain.protocol.model.mapping.surface_match import match_surface
from robrain.protocol.model.occupancy_grid import GridGeometry
from robrain.protocol.model.scan_agreement import agreement
from robrain.protocol.model.scan_match import BEAMS_MIN, ScanFit, points_in_view, search_scan
from robrain.protocol.model.small_linear_algebra import least_solution

Floats = NDArray[np.float64]
COMPARED_MIN = 0.5
"""Share of the beams that must end where the submap knows something …"""
AGREES_MIN = 0.75
"""… and of these, that must be as it says; chosen."""
DIRECTIONS_MIN = 2
SEARCH_M, SEARCH_RAD = 0.2, 0.06
"""A belief that is less sure than this is searched about before it is refined."""
WITHIN_M, WITHIN_RAD = 2.5, 0.5
"""The search goes no farther."""
WALL_SIGMA_M = 0.02
"""Standard deviation of where a scan lies: walls are drawn in cells."""
WALL_BEAMS = 20.0
"""So many beams on one wall err together; chosen."""


class Lying(NamedTuple):
    """A scan lies on a submap."""

    sensor: Pose2D
    """T_local_sensor in the submap's frame."""
    information: Floats
    """(3, 3) of that pose in x, y, yaw, in the axes of the submap's frame; 0 in directions that walls do not hold."""


class Contradiction(NamedTuple):
    """The submap knows the place, but the scan does not lie there."""

    agrees: float
    """Share of the beams that are as the submap says."""


def geometry_of(submap: Submap, team: GridGeometry) -> GridGeometry:
    """Where the submap's cells lie in its own frame, on the lattice of the team's grid."""
    height, width = submap.evidence.shape
    return GridGeometry(
        team.resolution_m,
        team.origin_x_m + submap.column * team.resolution_m,
        team.origin_y_m + submap.row * team.resolution_m,
        width,
        height,
    )


def lay_on(
    submap: Submap, team: GridGeometry, sensor: Pose2D, points: Floats, sigma_m: float, sigma_rad: float
) -> Lying | Contradiction | None:
    """Lay a scan on a submap.

    Args:
        submap: another than the one that the robot is making.
        team: the team's grid.
        sensor: where the sensor is believed to be, arena frame.
        points: (K, 2) the beams' ends in the sensor's frame.
        sigma_m: standard deviation of that place against the submap.
        sigma_rad: of that yaw.

    Returns:
        None if the submap does not know enough of the place to tell.

    """
    geometry = geometry_of(submap, team)
    guess = submap.T_arena_local.inverse().compose(sensor)
    if sigma_m > SEARCH_M or sigma_rad > SEARCH_RAD:
        found = search_scan(
            submap.evidence,
            geometry,
            guess,
            points,
            within_m=min(3.0 * sigma_m, WITHIN_M),
            within_rad=min(3.0 * sigma_rad, WITHIN_RAD),
        )
        if found is None:
            return None
        guess = found
    points = points_in_view(submap.evidence, geometry, guess, points)
    if len(points) < BEAMS_MIN:
        return None
    grid = submap.grid(team)
    fit, _ = match_surface(grid, guess, points)
    if fit.directions:
        guess = moved(guess, fit)
        fit, _ = match_surface(grid, guess, points)
        guess = moved(guess, fit) if fit.directions else guess
    share, compared = agreement(submap.evidence, geometry, guess, points)
    if compared < COMPARED_MIN * len(points):
        return None
    if len(fit.directions) < DIRECTIONS_MIN or share < AGREES_MIN:
        return Contradiction(share)
    information = np.zeros((3, 3))
    for direction in fit.directions:
        row = np.array(direction.row)
        variance = WALL_SIGMA_M**2 * (1.0 + WALL_BEAMS / direction.information)
        information += np.multiply.outer(row, row) / variance
    return Lying(guess, information)


def moved(guess: Pose2D, fit: ScanFit) -> Pose2D:
    """The guess, moved to where a scan fits."""
    rows = np.array([each.row for each in fit.directions])
    offsets_m = np.array([each.offset_m for each in fit.directions])
    x_m, y_m, yaw_rad = least_solution(rows, offsets_m).tolist()
    return Pose2D(guess.x_m + x_m, guess.y_m + y_m, math.remainder(guess.yaw_rad + yaw_rad, math.tau))
