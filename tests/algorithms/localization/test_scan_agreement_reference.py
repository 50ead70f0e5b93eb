"""How much of a scan is as the map says, beam by beam, against the definition."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.surface_match import agreement
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

GEOMETRY = GridGeometry(0.1, -0.7, 0.4, 40, 30)


def classes_at(log_odds, x_m, y_m):
    row, column = GEOMETRY.cell_of(x_m, y_m)
    return int(log_odds[row, column]) if GEOMETRY.contains(row, column) else 0


def beam_agrees(log_odds, sensor, point):
    """Whether a beam agrees; None if it is not compared."""
    range_m = math.hypot(*point)
    bearing_rad = sensor.yaw_rad + math.atan2(point[1], point[0])
    direction = math.cos(bearing_rad), math.sin(bearing_rad)
    is_blocked = False
    for at_m in np.arange(0.5, range_m - 0.3, 0.1).tolist():
        at = sensor.x_m + at_m * direction[0], sensor.y_m + at_m * direction[1]
        is_blocked = is_blocked or classes_at(log_odds, *at) > 0
    end = sensor.x_m + range_m * direction[0], sensor.y_m + range_m * direction[1]
    walls = np.argwhere(log_odds > 0) - np.array(GEOMETRY.cell_of(*end))
    is_near = bool((np.hypot(*walls.T) <= 2.0).any())
    if not (is_near or is_blocked or classes_at(log_odds, *end) != 0):
        return None
    return is_near and not is_blocked


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 100_000), st.sampled_from([0.005, 0.03]))
def test_a_beam_agrees_that_ends_at_a_wall_and_goes_through_none(seed, walls):
    rng = np.random.default_rng(seed)
    log_odds = rng.choice(np.array((50, -50, 0), np.int8), GEOMETRY.shape, p=(walls, 0.5, 0.5 - walls))
    sensor = Pose2D(*rng.uniform((-1.2, 0.0), (3.8, 3.8)).tolist(), float(rng.uniform(-3.1, 3.1)))
    bearings_rad, ranges_m = rng.uniform(-math.pi, math.pi, 30), rng.uniform(0.1, 3.0, 30)
    points = np.column_stack((ranges_m * np.cos(bearings_rad), ranges_m * np.sin(bearings_rad)))
    told = [beam_agrees(log_odds, sensor, point) for point in points.tolist()]
    compared = [each for each in told if each is not None]
    share, count = agreement(log_odds, GEOMETRY, sensor, points)
    assert count == len(compared)
    assert share == pytest.approx(sum(compared) / max(len(compared), 1))
