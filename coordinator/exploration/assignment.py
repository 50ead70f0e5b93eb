"""Which robot explores which frontier: one each, at the least sum of costs.

The cost of a frontier for a robot is the way there less what it promises (the unknown floor beyond it), plus a penalty
for being close to where another robot is already bound (in the manner of Burgard, Moors, Stachniss, Schneider,
Coordinated Multi-Robot Exploration, 2005). The assignment is optimal for these costs (Kuhn 1955, by scipy).
"""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Point2D

if TYPE_CHECKING:  # brings the map's kernels, which a coordinator loads when it is up (coordinator/live.py)
    from robrain.protocol.model.navigation.navigation_grid import NavigationGrid

GAIN_M_PER_M2 = 0.5
"""Metres of way that a square metre of unknown floor is worth."""
GAIN_LIMIT_M = 6.0
"""Most that it is worth. So pockets between shelves wait for the halves of a building, but not for ever: ten runs on
five floors know 95 % after 36 s on average and all after 67, where they took 46 and 67 s by the lengths of the
frontiers; with twice the worth it is 32 and 78 s."""
CROWD_RADIUS_M = 5.0
CROWD_PENALTY_M = 10.0
SNAP_M = 0.8
AVOID_RADIUS_M = 1.0
UNREACHABLE = 1e9


class Candidate(NamedTuple):
    """A frontier that might be handed out."""

    place: Point2D
    length_m: float
    unknown_m2: float = 0.0
    """Unknown area beyond it, as far as a robot there may see of it at once."""


class Seeker(NamedTuple):
    """A robot that has nothing to do."""

    name: str
    place: Point2D
    avoided: tuple[Point2D, ...] = ()
    """Places that it could not get to a short while ago."""


class Choice(NamedTuple):
    """A robot and the frontier that it gets."""

    robot: str
    place: Point2D
    cost_m: float
    way_m: float = math.nan
    """How far it is."""
    is_narrow: bool = False
    """Whether the path passes places with less than the preferred clearance."""


def assign_frontiers(
    navigation: "NavigationGrid",
    candidates: Sequence[Candidate],
    seekers: Sequence[Seeker],
    taken: Sequence[Point2D],
    shut: Sequence[tuple[float, float, float]] = (),
    choose: Callable[..., list[Choice]] | None = None,
) -> list[Choice]:
    """Give each robot at most one frontier and each frontier at most one robot.

    Args:
        navigation: the team's map.
        candidates: frontiers.
        seekers: robots without a goal.
        taken: goals of the other robots.
        shut: circles (x, y, radius in metres) whose narrow places are impassable.
        choose: the strategy; None for `assign`.

    Returns:
        The choices, by robot; robots that can reach no frontier are left out.

    """
    if not candidates or not seekers:
        return []
    ways_m = ways_to(navigation, candidates, seekers, shut)
    choose = choose or assign
    return choose(ways_m, candidates, seekers, taken, is_narrow=navigation.preferred_m > navigation.needed_m)


def ways_to(
    navigation: "NavigationGrid",
    candidates: Sequence[Candidate],
    seekers: Sequence[Seeker],
    shut: Sequence[tuple[float, float, float]] = (),
) -> NDArray[np.float64]:
    """Path cost from robots to frontiers, (robots, frontiers), metres of open floor; inf if there is no path."""
    cells = [navigation.snap(candidate.place, SNAP_M) for candidate in candidates]
    reachable = [(index, cell) for index, cell in enumerate(cells) if cell is not None]
    ways_m = np.full((len(seekers), len(candidates)), np.inf)
    for row, seeker in enumerate(seekers):
        found_m = navigation.ways_m(seeker.place, [cell for _, cell in reachable], snap_m=SNAP_M, shut=shut)
        for (column, _), way_m in zip(reachable, found_m, strict=True):
            ways_m[row, column] = way_m
    return ways_m


def assign(
    ways_m: NDArray[np.float64],
    candidates: Sequence[Candidate],
    seekers: Sequence[Seeker],
    taken: Sequence[Point2D],
    *,
    is_narrow: bool = False,
) -> list[Choice]:
    """Like `assign_frontiers`, with path costs (robots, frontiers) given."""
    # Imported here: it takes a third of a second, which would delay the coordinator's start.
    from scipy.optimize import linear_sum_assignment

    worth_m = np.array([min(GAIN_M_PER_M2 * candidate.unknown_m2, GAIN_LIMIT_M) for candidate in candidates])
    crowd_m = _crowding_m(candidates, taken)
    costs = np.full(ways_m.shape, UNREACHABLE)
    for row, seeker in enumerate(seekers):
        for column, candidate in enumerate(candidates):
            way_m = ways_m[row, column]
            if math.isfinite(way_m) and not is_avoided(candidate, seeker):
                costs[row, column] = way_m - worth_m[column] + crowd_m[column]
    rows, columns = linear_sum_assignment(costs)
    return [
        Choice(
            seekers[row].name,
            candidates[column].place,
            float(costs[row, column]),
            float(ways_m[row, column]),
            is_narrow,
        )
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        if costs[row, column] < UNREACHABLE
    ]


def nearest_frontier(
    ways_m: NDArray[np.float64],
    candidates: Sequence[Candidate],
    seekers: Sequence[Seeker],
    taken: Sequence[Point2D],
    *,
    is_narrow: bool = False,
) -> list[Choice]:
    """Each robot in turn takes the frontier that is nearest to it and still free.

    After Yamauchi, Frontier-Based Exploration Using Multiple Robots, 1998, in which robots do not coordinate; here no
    two share a goal. A baseline for comparison.
    """
    choices: list[Choice] = []
    free = {column for column, candidate in enumerate(candidates) if candidate.place not in taken}
    for row, seeker in enumerate(seekers):
        able = [
            (float(ways_m[row, column]), column)
            for column in free
            if math.isfinite(ways_m[row, column]) and not is_avoided(candidates[column], seeker)
        ]
        if able:
            way_m, column = min(able)
            free.remove(column)
            choices.append(Choice(seeker.name, candidates[column].place, way_m, way_m, is_narrow))
    return choices


def is_avoided(candidate: Candidate, seeker: Seeker) -> bool:
    """Whether a robot must not be sent to a frontier now."""
    return _near_any(candidate.place, seeker.avoided, AVOID_RADIUS_M)


def _crowding_m(candidates: Sequence[Candidate], taken: Sequence[Point2D]) -> NDArray[np.float64]:
    penalties = np.zeros(len(candidates))
    for index, candidate in enumerate(candidates):
        for goal in taken:
            away_m = math.hypot(candidate.place.x_m - goal.x_m, candidate.place.y_m - goal.y_m)
            penalties[index] += CROWD_PENALTY_M * max(0.0, 1.0 - away_m / CROWD_RADIUS_M)
    return penalties


def _near_any(place: Point2D, others: Sequence[Point2D], radius_m: float) -> bool:
    return any(math.hypot(place.x_m - other.x_m, place.y_m - other.y_m) < radius_m for other in others)
