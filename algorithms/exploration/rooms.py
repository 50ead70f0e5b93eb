"""Tours that know rooms, how much work is behind each frontier, and the ways of the other robots.

As `tours`, with four more things that the map shows. A frontier stands for the unknown floor that is nearer to it than
to the others, and takes a robot the longer, the more that is: so a robot is sent early to where much is left, and what
lies elsewhere falls to others. Changing rooms costs something, so that a robot finishes a room, or a branch of a
corridor, that it has begun (after Wurm, Stachniss, Burgard, *Coordinated multi-robot exploration using a segmentation
of the environment*, IROS 2008). And a way costs more where another robot comes towards it.
"""

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.exploration.situation import Choice, Situation
from robrain.algorithms.exploration.tours import FAR_M, LEAST_WEIGHT_M2, considered, taken_share

SHARE_LIMIT_M2 = 50.0
"""Most unknown floor that a frontier counts for (chosen)."""
STAY_M = 4.0
"""Way that a robot could make in the time that the smallest frontier takes it (chosen)."""
WORK_M_PER_M2 = 0.2
"""Way that a robot could make in the time that a square metre of unknown floor takes it (chosen; one robot alone drives
0.15 to 0.4 m for each square metre of the floors of `robrain bench exploration`)."""
DOOR_M = 1.0
"""Way that changing rooms counts for (chosen; with 4 m, four points take 24.9 instead of 23.4 s in a cave and 35.5
instead of 32.9 s in a depot, whose halls are no rooms)."""
MEET_M = 2.0
"""Way that a robot could make in the time that it and another give way to each other (chosen)."""
MEET_OVER_M = 2.0
"""Robots whose ways run against each other for this long meet for sure; for less, less so."""


def rooms(situation: Situation) -> list[Choice]:
    """Give each robot the first frontier of its tour; robots whose tour is empty get none."""
    if not situation.candidates or not situation.seekers:
        return []
    # Imported here: it brings the compiler, which would delay the coordinator's start.
    from robrain.algorithms.exploration.tour_kernels import Places, plan_tours

    shares_m2 = _shares_m2(situation)
    weights = (LEAST_WEIGHT_M2 + np.minimum(shares_m2, SHARE_LIMIT_M2)) * taken_share(situation)
    columns = considered(situation, weights, STAY_M)
    if not columns:
        return []
    first_m = (situation.ways_m + meetings_m(situation))[:, columns]
    between_m = situation.between(columns)
    if situation.floor is not None:
        room_of = situation.floor.frontier_rooms[columns]
        own = np.array([situation.floor.room_of(seeker.place) for seeker in situation.seekers])
        first_m += DOOR_M * (own[:, None] != room_of[None, :])
        between_m += DOOR_M * (room_of[:, None] != room_of[None, :])
    stays_m = STAY_M + WORK_M_PER_M2 * shares_m2[columns]
    found = plan_tours(Places(first_m, between_m, weights[columns], stays_m, FAR_M))
    return [
        situation.choice(row, columns[tour[0]], float(situation.ways_m[row, columns[tour[0]]]))
        for row, tour in enumerate(found)
        if tour
    ]


def meetings_m(situation: Situation) -> NDArray[np.float64]:
    """Way lost on the way to each frontier to robots that come towards the robot, (seekers, frontiers), metres.

    Two ways, from a to b and from c to d, run against each other over half of ab + cd − ad − cb, if the paths between
    all of them are those of a tree, as in a building of rooms and corridors they nearly are.
    """
    ways_m = np.concatenate([situation.ways_m, situation.busy_ways_m])
    goals = [*(seeker.goal for seeker in situation.seekers), *(robot.goal for robot in situation.busy)]
    lost_m = np.zeros_like(situation.ways_m)
    for mate, goal in enumerate(goals):
        column = None if goal is None else situation.column_of(goal)
        if column is None or not np.isfinite(ways_m[mate, column]):
            continue
        own_m = situation.ways_m
        with np.errstate(invalid="ignore"):
            against_m = 0.5 * (own_m + ways_m[mate, column] - own_m[:, column, None] - ways_m[mate])
        against_m = np.where(np.isfinite(against_m), against_m, 0.0)
        if mate < len(own_m):
            against_m[mate] = 0.0
        lost_m += MEET_M * np.clip(against_m / MEET_OVER_M, 0.0, 1.0)
    return lost_m


def _shares_m2(situation: Situation) -> NDArray[np.float64]:
    if situation.floor is None:
        return np.array([candidate.unknown_m2 for candidate in situation.candidates])
    return situation.floor.shares_m2
