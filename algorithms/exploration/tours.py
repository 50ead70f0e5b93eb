"""Which robot explores which frontiers, and in which order: tours that reach much unknown floor early.

All frontiers are shared out in one tour for each robot, so that the sum over the frontiers of unknown floor times way
until a robot is there is small; each robot is sent to the first of its tour. Frontiers of one room or of one branch lie
together, so they fall to one robot, and the others are sent elsewhere. A robot leaves a room behind only if what it
gains earlier elsewhere outweighs the way back.
"""

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.exploration.situation import Choice, Situation

LEAST_WEIGHT_M2 = 0.3
"""Every frontier counts as if this much more were unknown beyond it, so that none is left for ever (chosen)."""
UNKNOWN_LIMIT_M2 = 12.0
"""Most unknown floor that a frontier counts for (chosen), since the estimate says little beyond it."""
STAY_M = 8.0
"""Way that a robot of a team could make in the time that a frontier takes it (chosen): the longer, the more evenly
frontiers are shared out. With ideal motion and 8 seeds, four robots know 95 % of five floors after 37.3 s on average;
with half of it after 39.2 s, with one and a half times after 36.8 s."""
STAY_ALONE_M = 4.0
"""The same for a robot that explores alone, to which frontiers close together are close together."""
FAR_M = 40.0
"""A way of this length counts for half of what it would (chosen): what lies far ahead is uncertain."""
SHARED_M = 5.0
"""A frontier within this path of another robot's goal counts for less, down to nothing at the goal itself."""
CONSIDERED = 48
"""Frontiers that are shared out at a time: those that promise most for their distance."""


def tours(situation: Situation) -> list[Choice]:
    """Give each robot the first frontier of its tour; robots whose tour is empty get none."""
    if not situation.candidates or not situation.seekers:
        return []
    # Imported here: it brings the compiler, which would delay the coordinator's start.
    from robrain.algorithms.exploration.tour_kernels import Places, plan_tours

    stay_m = STAY_ALONE_M if len(situation.seekers) + len(situation.busy) == 1 else STAY_M
    weights = _weights_m2(situation)
    columns = considered(situation, weights, stay_m)
    if not columns:
        return []
    found = plan_tours(
        Places(
            situation.ways_m[:, columns],
            situation.between(columns),
            weights[columns],
            np.full(len(columns), stay_m),
            FAR_M,
        )
    )
    return [
        situation.choice(row, columns[tour[0]], float(situation.ways_m[row, columns[tour[0]]]))
        for row, tour in enumerate(found)
        if tour
    ]


def _weights_m2(situation: Situation) -> NDArray[np.float64]:
    """What each frontier promises, (frontiers,), square metres; next to nothing at other robots' goals."""
    unknown_m2 = np.array([min(one.unknown_m2, UNKNOWN_LIMIT_M2) for one in situation.candidates])
    return (LEAST_WEIGHT_M2 + unknown_m2) * taken_share(situation)


def taken_share(situation: Situation) -> NDArray[np.float64]:
    """By how much each frontier counts for less because it is near a busy robot's goal, (frontiers,), above 0 to 1."""
    if not situation.busy:
        return np.ones(len(situation.candidates))
    share: NDArray[np.float64] = np.maximum(np.minimum(situation.taken_m.min(axis=0) / SHARED_M, 1.0), 1e-3)
    return share


def considered(situation: Situation, weights: NDArray[np.float64], stay_m: float) -> list[int]:
    """Numbers of the frontiers to share out, ascending; none that no robot can reach."""
    least_m = situation.ways_m.min(axis=0)
    value = np.where(np.isfinite(least_m), weights / (least_m + stay_m), 0.0)
    order = np.argsort(-value, kind="stable")[:CONSIDERED]
    return sorted(column for column in order.tolist() if value[column] > 0)
