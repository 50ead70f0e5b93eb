"""Exploration strategies by name: which idle robot is sent to which frontier.

`[planning] exploration` of a scenario or a planning file chooses one. A strategy of another distribution is checked. If
it fails or makes a forbidden choice, this is counted and reported with the line of its file. The strategy `joint` then
replaces it. A lockstep run ends with the failure.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.exploration.situation import Choice, FrontierCandidate, Situation
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.registry import Registry, failure_text

GAIN_M_PER_M2 = 1.0
"""Metres of path that a square metre of unknown floor is worth."""
GAIN_LIMIT_M = 10.0
"""Largest value of a frontier's unknown floor. Pockets between shelves wait for the halves of a building, but not for
ever. With ideal motion, goals revised every second and 8 seeds, two robots know 95 % of a hospital's floor after 127 s.
With half of this value and kept goals they take 162 s."""
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
    paths_m = situation.paths_m
    costs = np.where(np.isfinite(paths_m), paths_m + added_m, UNREACHABLE)
    rows, columns = linear_sum_assignment(costs)
    return [
        situation.choice(row, column, costs[row, column])
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        if costs[row, column] < UNREACHABLE
    ]


def worth_m(situation: Situation) -> NDArray[np.float64]:
    """Value of each frontier, (frontiers,), in metres of path."""
    return np.array([min(GAIN_M_PER_M2 * candidate.unknown_m2, GAIN_LIMIT_M) for candidate in situation.candidates])


def _crowding_m(candidates: tuple[FrontierCandidate, ...], claimed: list[Point2D]) -> NDArray[np.float64]:
    penalties = np.zeros(len(candidates))
    for index, candidate in enumerate(candidates):
        for goal in claimed:
            away_m = candidate.place.distance_m(goal)
            penalties[index] += CROWD_PENALTY_M * max(0.0, 1.0 - away_m / CROWD_RADIUS_M)
    return penalties


SEEN_M = 6.0
"""Burgard's strategy: a robot at a frontier may see others within this path, as far as its lidar reaches."""
UTILITY_M = 8.0
"""Metres of path that a frontier's full utility is worth. Chosen: the best of 4, 8, 16 and 32 on the maps of `robrain
bench exploration`. Burgard and others report little influence."""


def nearest(situation: Situation) -> list[Choice]:
    """Each robot in turn takes the nearest frontier that is still free.

    After Yamauchi, Frontier-Based Exploration Using Multiple Robots, 1998.
    """
    return _in_turn(situation, np.zeros(situation.paths_m.shape, np.int64))


def minpos(situation: Situation) -> list[Choice]:
    """Each robot takes the frontier to which the fewest robots are nearer, and the nearest among those.

    After Bautin, Simonin, Charpillet, MinPos: A Novel Frontier Allocation Algorithm for Multi-robot Exploration, ICIRA
    2012. All robots count, also those that keep their goals.
    """
    paths_m = np.concatenate([situation.paths_m, situation.busy_paths_m])
    return _in_turn(situation, np.array([np.count_nonzero(paths_m < own_m, axis=0) for own_m in situation.paths_m]))


def _in_turn(situation: Situation, ranks: NDArray[np.int64]) -> list[Choice]:
    """Each robot in turn takes the free frontier of the least rank (seekers, frontiers), the nearest among those."""
    claimed = _claimed(situation)
    choices: list[Choice] = []
    for row, paths_m in enumerate(situation.paths_m.tolist()):
        able = [
            (int(ranks[row, column]), path_m, column)
            for column, path_m in enumerate(paths_m)
            if column not in claimed and math.isfinite(path_m)
        ]
        if able:
            *_, column = min(able)
            claimed.add(column)
            choices.append(situation.choice(row, column))
    return choices


def burgard(situation: Situation) -> list[Choice]:
    """The pair of robot and frontier with the best utility less path cost, repeatedly.

    A frontier's utility falls by the chance that it is seen from an assigned frontier. This chance is 1 at distance 0
    and falls linearly with the path between them to 0 at the sensor's range. After Burgard, Moors, Stachniss,
    Schneider, Coordinated Multi-Robot Exploration, IEEE Transactions on Robotics 21(3), 2005, algorithm 1.
    """
    utility = 1.0 - _seen_from(situation.goal_paths_m).sum(axis=0)
    paths_m = situation.paths_m.copy()
    paths_m[:, sorted(_claimed(situation))] = math.inf
    choices: list[Choice] = []
    while np.isfinite(paths_m).any():
        value_m = UTILITY_M * utility[np.newaxis, :] - paths_m
        row, column = (int(index) for index in np.unravel_index(np.argmax(value_m), value_m.shape))
        choices.append(situation.choice(row, column, -float(value_m[row, column])))
        paths_m[row] = paths_m[:, column] = math.inf
        utility -= _seen_from(situation.between_m[column])
    return choices


def _seen_from(path_m: np.ndarray) -> np.ndarray:
    return np.maximum(0.0, 1.0 - path_m / SEEN_M)


def _claimed(situation: Situation) -> set[int]:
    """Numbers of the frontiers that are other robots' goals."""
    goals = {robot.goal for robot in situation.busy}
    return {column for column, candidate in enumerate(situation.candidates) if candidate.place in goals}


NEAREST: Final = "nearest"
"""Each robot in turn the frontier nearest to it (Yamauchi 1998)."""
MINPOS: Final = "minpos"
"""Each robot the frontier to which the fewest robots are nearer (Bautin and others 2012)."""
BURGARD: Final = "burgard"
"""The best pair of utility and cost, repeatedly, with lower utilities near assigned frontiers (2005)."""
JOINT: Final = "joint"
"""One frontier each, at the least sum of path costs less the frontiers' values."""

TOURS: Final = "tours"
"""Tours through all frontiers that reach much unknown floor early; each robot begins its own."""

ROOMS: Final = "rooms"
"""Tours that consider rooms, the work behind each frontier, and the paths of the other robots."""

AUTO: Final = "auto"
"""The default: `tours` for up to four robots, or `rooms` for three and four where rooms are small; `joint` for more."""


NO_EXPLORATION: Final = "none"
"""Robots explore only for a task."""


Strategy = Callable[[Situation], list[Choice]]
"""Sends idle robots to frontiers: at most one for each seeker. Equal situations give equal choices."""
BASELINES = "robrain.algorithms.exploration.strategies"
STRATEGIES: Registry[Strategy] = Registry(
    "exploration",
    "robrain.exploration_strategies",
    {
        AUTO: "robrain.algorithms.exploration.tours:auto",
        NEAREST: f"{BASELINES}:nearest",
        MINPOS: f"{BASELINES}:minpos",
        BURGARD: f"{BASELINES}:burgard",
        JOINT: f"{BASELINES}:joint",
        TOURS: "robrain.algorithms.exploration.tours:tours",
        ROOMS: "robrain.algorithms.exploration.tours:rooms",
    },
    has_files=True,
)


def strategy_of(name: str, on_failure: Callable[[str, str], None]) -> Strategy:
    """The strategy of a name; one of another distribution is checked each time.

    Args:
        name: as in `STRATEGIES`.
        on_failure: receives the name and the reason whenever a foreign strategy fails or makes a forbidden choice.

    Raises:
        UnknownEntry: there is none of this name, or it cannot be imported.

    """
    if name == NO_EXPLORATION:
        return lambda _situation: []
    strategy = STRATEGIES.get(name)
    return strategy if STRATEGIES.is_stock(name) else _checked(name, strategy, on_failure)


def _checked(name: str, strategy: Strategy, on_failure: Callable[[str, str], None]) -> Strategy:
    def choose(situation: Situation) -> list[Choice]:
        try:
            made: object = strategy(situation)
            if not isinstance(made, list):
                raise TypeError(f"expected a list of Choice, got {type(made).__name__}")
            if reason := _choices_refusal(made, situation):
                raise ValueError(reason)
        except Exception as error:  # noqa: BLE001 - foreign code
            on_failure(name, failure_text(strategy, error))
            return joint(situation)
        return made

    return choose


def _choices_refusal(made: Sequence[object], situation: Situation) -> str:
    """Error in some choices, in words; empty if there is none."""
    rows = {seeker.name: row for row, seeker in enumerate(situation.seekers)}
    columns = {candidate.place: column for column, candidate in enumerate(situation.candidates)}
    robots: set[str] = set()
    places: set[Point2D] = set()
    for choice in made:
        if not isinstance(choice, Choice):
            return f"expected a list of Choice, got one of {type(choice).__name__}"
        place: object = choice.place
        cost_m: object = choice.cost_m
        if not isinstance(place, Point2D):
            return f"expected the place of {choice.robot} to be a Point2D, got {type(place).__name__}"
        if not isinstance(cost_m, float | int) or not math.isfinite(cost_m):
            return f"expected a finite cost_m for {choice.robot}, got {cost_m!r}"
        if choice.robot not in rows or choice.robot in robots:
            return f"{choice.robot} is not idle, or is chosen twice"
        if choice.place not in columns or choice.place in places:
            return f"{choice.robot} is sent to what is no frontier, or is another's"
        if not math.isfinite(situation.paths_m[rows[choice.robot], columns[choice.place]]):
            return f"{choice.robot} has no path to its frontier"
        robots.add(choice.robot)
        places.add(choice.place)
    return ""
