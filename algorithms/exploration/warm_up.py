"""Loads the compiled functions of the team's map and its exploration, so that no step of a coordinator pays for it."""

import numpy as np

from robrain.algorithms.exploration.map_survey import MapSurvey
from robrain.algorithms.exploration.situation import FrontierCandidate, FrontierPaths, Seeker, Situation
from robrain.algorithms.exploration.strategies import joint
from robrain.algorithms.exploration.tours import rooms, tours
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.navigation.frontier import find_frontiers
from robrain.algorithms.navigation.navigation_grid import NavigationGrid
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, GridGeometry

SIDE = 24
"""Cells of the floor on which it is tried."""


def warm_up() -> None:
    """Explore a floor of a few square metres.

    The first call on a computer compiles and stores the machine code beside the sources (some seconds); later
    processes load it (tenths of a second).
    """
    geometry = GridGeometry(0.1, 0.0, 0.0, SIDE, SIDE)
    grid = OccupancyGrid(geometry)
    grid.merge_patch(0, 0, np.full((SIDE, SIDE // 2), FREE), 1)
    classes = grid.classes()
    navigation = NavigationGrid(classes, geometry, 0.3)
    navigation.update(classes)
    found = [FrontierCandidate(geometry.center_of(one.row, one.column), 1.0) for one in find_frontiers(classes)]
    costs_m = FrontierPaths(navigation, found).costs_m
    situation = Situation(
        found, [Seeker("r", Point2D(0.6, 1.2))], [], costs_m, floor=MapSurvey(grid, [one.place for one in found])
    )
    for strategy in (joint, tours, rooms):
        strategy(situation)
