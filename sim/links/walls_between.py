"""How many walls a line of sight crosses on a floor plan."""

import math

import numpy as np

from robrain.sim.maps.floor_plan import FloorPlan

STEPS_PER_CELL = 2.0
"""Samples of a line for each cell that it is long; a wall that is thinner than a cell at its corner may be missed."""


def walls_between(plan: FloorPlan, from_m: tuple[float, float], to_m: tuple[float, float]) -> int:
    """How often the straight line between two places, metres, arena frame, enters a wall; outside the plan is none."""
    length_m = math.sqrt((to_m[0] - from_m[0]) ** 2 + (to_m[1] - from_m[1]) ** 2)
    steps = max(1, math.ceil(STEPS_PER_CELL * length_m / plan.resolution_m))
    along = np.arange(steps + 1) / steps
    columns = np.floor((from_m[0] + along * (to_m[0] - from_m[0]) - plan.origin_x_m) / plan.resolution_m).astype(int)
    rows = np.floor((from_m[1] + along * (to_m[1] - from_m[1]) - plan.origin_y_m) / plan.resolution_m).astype(int)
    height, width = plan.occupied.shape
    within = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    is_wall = np.zeros(steps + 1, dtype=bool)
    is_wall[within] = plan.occupied[rows[within], columns[within]]
    return int(np.count_nonzero(is_wall[1:] & ~is_wall[:-1]))
