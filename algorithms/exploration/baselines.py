"""Exploration strategies from the literature, for comparison.

Each gives a robot at most one frontier and a frontier to at most one robot; the first two were published without that.
"""

import math

import numpy as np

from robrain.algorithms.exploration.situation import Choice, Situation

SEEN_M = 6.0
"""Burgard's strategy: a robot at a frontier may see others within this path, as far as its lidar reaches."""
UTILITY_M = 8.0
"""Metres of path that a frontier's full utility is worth (chosen: the best of 4, 8, 16 and 32 on the maps of
`robrain bench exploration`; Burgard and others report little influence)."""


def nearest(situation: Situation) -> list[Choice]:
    """Each robot in turn takes the nearest frontier that is still free.

    After Yamauchi, Frontier-Based Exploration Using Multiple Robots, 1998.
    """
    taken = _taken(situation)
    choices: list[Choice] = []
    for row, ways_m in enumerate(situation.ways_m):
        able = [(way_m, column) for column, way_m in enumerate(ways_m.tolist()) if _is_able(way_m, column, taken)]
        if able:
            way_m, column = min(able)
            taken.add(column)
            choices.append(situation.choice(row, column, way_m))
    return choices


def minpos(situation: Situation) -> list[Choice]:
    """Each robot takes the frontier to which the fewest robots are nearer, and the nearest among those.

    After Bautin, Simonin, Charpillet, MinPos: A Novel Frontier Allocation Algorithm for Multi-robot Exploration, ICIRA
    2012. All robots count, also those that keep their goals.
    """
    taken = _taken(situation)
    ways_m = np.concatenate([situation.ways_m, situation.busy_ways_m])
    choices: list[Choice] = []
    for row in range(len(situation.seekers)):
        nearer = np.count_nonzero(ways_m < ways_m[row], axis=0).tolist()
        own_m = ways_m[row].tolist()
        able = [(nearer[column], way_m, column) for column, way_m in enumerate(own_m) if _is_able(way_m, column, taken)]
        if able:
            _, way_m, column = min(able)
            taken.add(column)
            choices.append(situation.choice(row, column, way_m))
    return choices


def burgard(situation: Situation) -> list[Choice]:
    """The pair of robot and frontier with the best utility less path cost, again and again.

    A frontier's utility falls by the chance that it is seen from one that was given away: 1 at none, falling linearly
    with the path between them to 0 at the range of the sensor. After Burgard, Moors, Stachniss, Schneider, Coordinated
    Multi-Robot Exploration, IEEE Transactions on Robotics 21(3), 2005, algorithm 1.
    """
    utility = 1.0 - _seen_from(situation.taken_m).sum(axis=0)
    ways_m = situation.ways_m.copy()
    ways_m[:, sorted(_taken(situation))] = math.inf
    choices: list[Choice] = []
    while np.isfinite(ways_m).any():
        value_m = UTILITY_M * utility[np.newaxis, :] - ways_m
        row, column = (int(index) for index in np.unravel_index(np.argmax(value_m), value_m.shape))
        choices.append(situation.choice(row, column, -float(value_m[row, column])))
        ways_m[row] = ways_m[:, column] = math.inf
        utility -= _seen_from(situation.between_m[column])
    return choices


def _seen_from(path_m: np.ndarray) -> np.ndarray:
    return np.maximum(0.0, 1.0 - path_m / SEEN_M)


def _taken(situation: Situation) -> set[int]:
    """Numbers of the frontiers that are other robots' goals."""
    goals = {robot.goal for robot in situation.busy}
    return {column for column, candidate in enumerate(situation.candidates) if candidate.place in goals}


def _is_able(way_m: float, column: int, taken: set[int]) -> bool:
    return column not in taken and math.isfinite(way_m)
