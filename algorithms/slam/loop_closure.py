"""Match a scan against a submap to find a loop closure.

The match starts from the pose estimate. If the estimate is uncertain, a correlative search comes first (Olson,
*Real-time correlative scan matching*, ICRA 2009), then Gauss–Newton. The match is accepted only if enough beams end in
known cells of the submap and most of them agree with it. The search must also find no second pose of similar score.
"""

import math
from typing import NamedTuple

import numpy as np

from robrain.algorithms.localization.scan_match import BEAMS_MIN, ScanFit, points_in_view, search_scan
from robrain.algorithms.localization.surface_match import agreement, match_surface
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.numeric.small_linear_algebra import least_solution
from robrain.algorithms.slam.submap import Submap
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

COMPARED_MIN = 0.5
"""Least share of the beams that end in known cells of the submap."""
AGREES_MIN = 0.75
"""Least share of the compared beams that agree with the submap; leaves room for things that moved."""
DIRECTIONS_MIN = 2
"""Least number of directions of (x, y, yaw) that the walls determine."""
SEARCH_M, SEARCH_RAD = 0.2, 0.06
"""Standard deviations, metres and radians, above which a search precedes the refinement."""
WITHIN_M, WITHIN_RAD = 2.5, 0.5
"""Largest offset from the estimate that is searched, metres and radians."""
WALL_SIGMA_M = 0.02
"""Standard deviation of a match along one direction, metres."""
WALL_BEAMS = 20.0
"""Number of beams on one wall whose errors are taken to be equal, so that they count as one."""


class Lying(NamedTuple):
    """A scan matches a submap."""

    sensor: Pose2D
    """T_local_sensor in the submap's frame."""
    information: Floats
    """(3, 3) inverse covariance of x, y, yaw in the submap's frame; 0 in directions that walls do not determine."""


class Contradiction(NamedTuple):
    """The submap covers the place, but the scan does not match it."""

    agrees: float
    """Share of the beams that agree with the submap."""


def lay_on(
    submap: Submap, team: GridGeometry, sensor: Pose2D, points: Floats, sigma_m: float, sigma_rad: float
) -> Lying | Contradiction | None:
    """Match a scan against a submap.

    Args:
        submap: any but the current one.
        team: the team's grid.
        sensor: estimated pose of the sensor, arena frame.
        points: (K, 2) ends of the beams in the sensor's frame, metres.
        sigma_m: standard deviation of the estimated position relative to the submap.
        sigma_rad: standard deviation of the estimated yaw.

    Returns:
        None if the submap covers too little of the place to decide.

    """
    geometry = submap.geometry(team)
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
    """The guess, corrected by the offsets of a fit."""
    rows = np.array([each.row for each in fit.directions])
    offsets_m = np.array([each.offset_m for each in fit.directions])
    x_m, y_m, yaw_rad = least_solution(rows, offsets_m).tolist()
    return Pose2D(guess.x_m + x_m, guess.y_m + y_m, math.remainder(guess.yaw_rad + yaw_rad, math.tau))
