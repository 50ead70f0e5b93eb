"""Which robot explores which frontier: one each, at the least sum of costs.

The cost of a frontier for a robot is the way there less what it promises (the unknown floor beyond it), plus a penalty
for being close to where another robot is already bound (in the manner of Burgard, Moors, Stachniss, Schneider,
Coordinated Multi-Robot Exploration, 2005). The assignment is optimal for these costs (Kuhn 1955, by scipy).
"""

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.exploration.situation import Choice, FrontierCandidate, Situation
from robrain.protocol.model.geometry import Point2D

GAIN_M_PER_M2 = 1.0
"""Metres of way that a square metre of unknown floor is worth."""
GAIN_LIMIT_M = 10.0
"""Most that it is worth. So pockets between shelves wait for the halves of a building, but not for ever. With ideal
motion, goals revised every second and 8 seeds, two robots know 95 % of a hospital's floor after 127 s, where half of
this worth and kept goals took 162 s."""
CROWD_RADIUS_M = 5.0
CROWD_PENALTY_M = 10.0
UNREACHABLE = 1e9


def joint(situation: Situation) -> list[Choice]:
    """Give each robot at most one frontier and each frontier at most one robot; those that can reach none get none."""
    if not situation.candidates or not situation.seekers:
        return []
    # Imported here: it takes a third of a second, which would delay the coordinator's start.
    from scipy.optimize import linear_sum_assignment

    added_m = _crowding_m(situation.candidates, [robot.goal for robot in situation.busy]) - worth_m(situation)
    ways_m = situation.ways_m
    costs = np.where(np.isfinite(ways_m), ways_m + added_m, UNREACHABLE)
    rows, columns = linear_sum_assignment(costs)
    return [
        situation.choice(row, column, costs[row, column])
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        if costs[row, column] < UNREACHABLE
    ]


def worth_m(situation: Situation) -> NDArray[np.float64]:
    """What each frontier promises, (frontiers,), in metres of way."""
    return np.array([min(GAIN_M_PER_M2 * candidate.unknown_m2, GAIN_LIMIT_M) for candidate in situation.candidates])


def _crowding_m(candidates: tuple[FrontierCandidate, ...], taken: list[Point2D]) -> NDArray[np.float64]:
    penalties = np.zeros(len(candidates))
    for index, candidate in enumerate(candidates):
        for goal in taken:
            away_m = candidate.place.distance_m(goal)
            penalties[index] += CROWD_PENALTY_M * max(0.0, 1.0 - away_m / CROWD_RADIUS_M)
    return penalties
