"""Camera positions from which a whole map is seen."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.grid_geometry import GridGeometry

FOV_RAD = math.radians(45)
"""Vertical field of view; narrower than viser's 75°, which bends a floor plan."""
OVERVIEW_ELEVATION_RAD = math.radians(58)
TOP_ELEVATION_RAD = math.radians(89.5)
"""Slightly below 90°, where the camera has no up direction; so that +y is up on the screen."""
FILL = 0.92
"""Share of the picture that the map may fill."""

Bounds = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max; metres, arena frame."""


def bounds_of(geometry: GridGeometry) -> Bounds:
    """The bounds of a whole grid."""
    x_max_m = geometry.origin_x_m + geometry.width * geometry.resolution_m
    y_max_m = geometry.origin_y_m + geometry.height * geometry.resolution_m
    return (geometry.origin_x_m, geometry.origin_y_m, x_max_m, y_max_m)


class Standpoint(NamedTuple):
    """A camera's position and target, metres, arena frame."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]


def viewpoint_of(bounds: Bounds, elevation_rad: float, aspect: float, covered: float = 0.0) -> Standpoint:
    """The nearest standpoint from which all of `bounds` is seen, looking along +y from `elevation_rad` above the floor.

    `aspect` is the picture's width by its height, `covered` the share of it that panels cover at the bottom. The
    visible area is centred in the remaining space; the middle of the floor is not, as perspective would push it up.
    """
    x_min, y_min, x_max, y_max = bounds
    middle = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, 0.0])
    forward = np.array([0.0, math.cos(elevation_rad), -math.sin(elevation_rad)])
    up = np.array([0.0, math.sin(elevation_rad), math.cos(elevation_rad)])
    corners = np.array([[x, y, 0.0] for x in (x_min, x_max) for y in (y_min, y_max)]) - middle
    tan_up = math.tan(FOV_RAD / 2) * FILL
    tan_side = tan_up * max(aspect, 0.1)
    sideways, upwards, depth = corners[:, 0], corners @ up, corners @ forward

    # With the eye at −distance along `forward` and raised by `lift`, each corner has to stay within the picture:
    # |sideways| ≤ tan_side (distance + depth) and −tan_down (…) ≤ upwards − lift ≤ tan_up (distance + depth).
    tan_down = tan_up * (1 - 2 * covered)
    for_width = float(np.max(np.abs(sideways) / tan_side - depth))
    top, bottom = upwards - tan_up * depth, upwards + tan_down * depth
    for_height = float(np.max(top) - np.min(bottom)) / (tan_up + tan_down)
    distance = max(for_width, for_height, 1.0)
    lift = (float(np.max(top)) - tan_up * distance + float(np.min(bottom)) + tan_down * distance) / 2
    target = middle + lift * up
    # On the floor again, so that the orbit turns about a point of it.
    target = target + forward * (target[2] / math.sin(elevation_rad))
    eye = middle + lift * up - distance * forward
    return Standpoint(_tuple(eye), _tuple(target))


def _tuple(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])
