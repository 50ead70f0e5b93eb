"""Which robot explores which frontiers, and in which order: tours that reach much unknown floor early.

All frontiers are shared out in one tour for each robot. The tours keep small the sum over the frontiers of unknown
floor times the path until a robot is there. Each robot is sent to the first frontier of its tour. Frontiers of one room
or of one branch lie together, so they fall to one robot, and the others are sent elsewhere. A robot leaves a room only
if the earlier gain elsewhere outweighs the path back.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.exploration.situation import Choice, Situation
from robrain.algorithms.exploration.strategies import joint

ROUNDS = 20
"""Rounds of moves at most; almost all are settled after five."""
LEAST_SAVING = 1e-6
"""A move has to save this, so that rounding never makes two tours change places for ever."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Places(NamedTuple):
    """Places to visit."""

    first_m: Floats
    """Path length of each robot to each place (robots, places), metres; inf where there is none."""
    between_m: Floats
    """Path lengths between the places (places, places)."""
    weights: Floats
    """Value of reaching each place early (places,), above 0."""
    stay_m: Floats
    """Path length that could be driven in the time which each place takes (places,)."""
    far_m: float
    """A path of this length counts for half of its value; longer ones for less and less."""


class Tours(NamedTuple):
    """Tours as far as they are made."""

    places: Ints
    """(robots, places + 1), −1 behind each robot's last."""
    lengths: Ints
    """(robots,)."""
    costs: Floats
    """(robots,)."""
    tried: Ints
    """(places + 1,), for a tour that is tried."""


def plan_tours(places: Places) -> list[list[int]]:
    """A tour for each robot; every place that some robot can reach is in one of them."""
    robots, count = places.first_m.shape
    first_m, between_m, weights, stay_m = [np.ascontiguousarray(array, np.float64) for array in places[:4]]
    exact = Places(first_m, between_m, weights, stay_m, float(places.far_m))
    tours = Tours(
        np.full((robots, count + 1), -1, np.int64),
        np.zeros(robots, np.int64),
        np.zeros(robots),
        np.empty(count + 1, np.int64),
    )
    _plan(exact, tours)
    return [tours.places[robot, : tours.lengths[robot]].tolist() for robot in range(robots)]


@njit(cache=True, nogil=True)
def _cost(places: Places, robot: int, tour: Ints, length: int) -> float:
    """Sum of weight times path length of one tour; inf if it cannot be driven."""
    path_m, cost = 0.0, 0.0
    for index in range(length):
        place = tour[index]
        path_m += places.first_m[robot, place] if index == 0 else places.between_m[tour[index - 1], place]
        cost += places.weights[place] * path_m * places.far_m / (path_m + places.far_m)
        path_m += places.stay_m[place]
    return cost


@njit(cache=True, nogil=True)
def _insert(tour: Ints, length: int, place: int, position: int, into: Ints) -> None:
    for index in range(position):
        into[index] = tour[index]
    into[position] = place
    for index in range(position, length):
        into[index + 1] = tour[index]


@njit(cache=True, nogil=True)
def _best_insertion(places: Places, tours: Tours, place: int) -> tuple[float, int, int]:
    """Cost of the best insertion of a place, with its robot and position; inf if no robot can reach the place."""
    best, best_robot, best_position = np.inf, -1, -1
    for robot in range(places.first_m.shape[0]):
        if places.first_m[robot, place] == np.inf:
            continue
        length = tours.lengths[robot]
        for position in range(length + 1):
            _insert(tours.places[robot], length, place, position, tours.tried)
            added = _cost(places, robot, tours.tried, length + 1) - tours.costs[robot]
            if added < best:
                best, best_robot, best_position = added, robot, position
    return best, best_robot, best_position


@njit(cache=True, nogil=True)
def _put(tours: Tours, robot: int, place: int, position: int) -> None:
    for index in range(tours.lengths[robot], position, -1):
        tours.places[robot, index] = tours.places[robot, index - 1]
    tours.places[robot, position] = place
    tours.lengths[robot] += 1


@njit(cache=True, nogil=True)
def _remove(tours: Tours, robot: int, position: int) -> None:
    for index in range(position + 1, tours.lengths[robot]):
        tours.places[robot, index - 1] = tours.places[robot, index]
    tours.lengths[robot] -= 1


@njit(cache=True, nogil=True)
def _move_places(places: Places, tours: Tours) -> bool:
    """Move places to where they add less, each once; whether any was moved."""
    is_better = False
    for robot in range(places.first_m.shape[0]):
        position = 0
        while position < tours.lengths[robot]:
            place, before = tours.places[robot, position], tours.costs[robot]
            _remove(tours, robot, position)
            tours.costs[robot] = _cost(places, robot, tours.places[robot], tours.lengths[robot])
            saved = before - tours.costs[robot]
            added, to_robot, to_position = _best_insertion(places, tours, place)
            if added < saved - LEAST_SAVING:
                _put(tours, to_robot, place, to_position)
                tours.costs[to_robot] += added
                is_better = True
            else:
                _put(tours, robot, place, position)
                tours.costs[robot] = before
                position += 1
    return is_better


@njit(cache=True, nogil=True)
def _reverse_stretches(places: Places, tours: Tours) -> bool:
    """Reverse stretches of tours where that saves; whether any was reversed."""
    is_better = False
    tried = tours.tried
    for robot in range(places.first_m.shape[0]):
        length = tours.lengths[robot]
        for start in range(length - 1):
            for end in range(start + 1, length):
                for index in range(length):
                    is_within = start <= index <= end
                    tried[index] = tours.places[robot, start + end - index if is_within else index]
                if places.first_m[robot, tried[0]] == np.inf:
                    continue
                cost = _cost(places, robot, tried, length)
                if cost < tours.costs[robot] - LEAST_SAVING:
                    tours.places[robot, :length] = tried[:length]
                    tours.costs[robot] = cost
                    is_better = True
    return is_better


@njit(cache=True, nogil=True)
def _plan(places: Places, tours: Tours) -> None:
    """Make the tours, which are empty at first."""
    count = places.weights.size
    is_open = np.ones(count, np.bool_)
    while True:
        least, found_place, found_robot, found_position = np.inf, -1, -1, -1
        for place in range(count):
            if is_open[place]:
                added, robot, position = _best_insertion(places, tours, place)
                if added < least:
                    least, found_place, found_robot, found_position = added, place, robot, position
        if found_place < 0:
            break
        _put(tours, found_robot, found_place, found_position)
        tours.costs[found_robot] += least
        is_open[found_place] = False
    for _ in range(ROUNDS):
        is_moved = _move_places(places, tours)
        is_reversed = _reverse_stretches(places, tours)
        if not (is_moved or is_reversed):
            break


LEAST_WEIGHT_M2 = 0.3
"""Every frontier counts as if this much more were unknown beyond it, so that none waits for ever (chosen)."""
UNKNOWN_LIMIT_M2 = 12.0
"""Most unknown floor that a frontier counts for (chosen), since the estimate is poor beyond it."""
STAY_M = 8.0
"""Path that a robot of a team could drive in the time that a frontier takes it (chosen). A longer path shares out the
frontiers more evenly. With ideal motion and 8 seeds, four robots know 95 % of five floors after 37.3 s on average. With
half of this value they take 39.2 s, with one and a half times 36.8 s."""
STAY_ALONE_M = 4.0
"""The same for a robot that explores alone, to which frontiers close together are close together."""
FAR_M = 40.0
"""A path of this length counts for half of its value (chosen): distant gains are uncertain."""
SHARED_M = 5.0
"""A frontier within this path of another robot's goal counts for less, down to nothing at the goal itself."""
CONSIDERED = 48
"""Frontiers that are shared out at a time: those that promise most for their distance."""


def tours(situation: Situation) -> list[Choice]:
    """Give each robot the first frontier of its tour; robots whose tour is empty get none."""
    if not situation.candidates or not situation.seekers:
        return []
    stay_m = STAY_ALONE_M if len(situation.seekers) + len(situation.busy) == 1 else STAY_M
    unknown_m2 = np.array([min(one.unknown_m2, UNKNOWN_LIMIT_M2) for one in situation.candidates])
    weights = (LEAST_WEIGHT_M2 + unknown_m2) * claimed_share(situation)
    columns = considered(situation, weights, stay_m)
    stays_m = np.full(len(columns), stay_m)
    places = Places(situation.paths_m[:, columns], situation.between(columns), weights[columns], stays_m, FAR_M)
    return _firsts(situation, columns, places)


def _firsts(situation: Situation, columns: list[int], places: Places) -> list[Choice]:
    """The first frontier of each robot's tour through these frontiers."""
    return [situation.choice(row, columns[tour[0]]) for row, tour in enumerate(plan_tours(places)) if tour]


def claimed_share(situation: Situation) -> NDArray[np.float64]:
    """By how much each frontier counts for less because it is near a busy robot's goal, (frontiers,), above 0 to 1."""
    if not situation.busy:
        return np.ones(len(situation.candidates))
    share: NDArray[np.float64] = np.maximum(np.minimum(situation.goal_paths_m.min(axis=0) / SHARED_M, 1.0), 1e-3)
    return share


def considered(situation: Situation, weights: NDArray[np.float64], stay_m: float) -> list[int]:
    """Numbers of the frontiers to share out, ascending; none that no robot can reach."""
    least_m = situation.paths_m.min(axis=0)
    value = np.where(np.isfinite(least_m), weights / (least_m + stay_m), 0.0)
    order = np.argsort(-value, kind="stable")[:CONSIDERED]
    return sorted(column for column in order.tolist() if value[column] > 0)


SHARE_LIMIT_M2 = 50.0
"""Most unknown floor that a frontier counts for (chosen)."""
ROOM_STAY_M = 4.0
"""Path length that a robot could drive in the time that the smallest frontier takes it (chosen)."""
WORK_M_PER_M2 = 0.2
"""Path that a robot could drive in the time that a square metre of unknown floor takes it (chosen). One robot alone
drives 0.15 to 0.4 m for each square metre of the floors of `robrain bench exploration`."""
DOOR_M = 1.0
"""Path that a change of rooms counts for (chosen). With 4 m, four points take 24.9 s instead of 23.4 s in a cave. In a
depot, whose halls are no rooms, they take 35.5 s instead of 32.9 s."""
MEET_M = 2.0
"""Path length that a robot could drive in the time that it and another give way to each other (chosen)."""
MEET_OVER_M = 2.0
"""Robots whose paths run against each other for this length surely meet; a shorter overlap counts less."""


def rooms(situation: Situation) -> list[Choice]:
    """Give each robot the first frontier of its tour; robots whose tour is empty get none."""
    if not situation.candidates or not situation.seekers:
        return []
    floor = situation.floor
    unknown_m2 = [candidate.unknown_m2 for candidate in situation.candidates]
    shares_m2 = np.array(unknown_m2) if floor is None else floor.shares_m2
    weights = (LEAST_WEIGHT_M2 + np.minimum(shares_m2, SHARE_LIMIT_M2)) * claimed_share(situation)
    columns = considered(situation, weights, ROOM_STAY_M)
    first_m = (situation.paths_m + meetings_m(situation))[:, columns]
    between_m = situation.between(columns)
    if floor is not None:
        room_of = floor.frontier_rooms[columns]
        own = np.array([floor.room_of(seeker.place) for seeker in situation.seekers])
        first_m += DOOR_M * (own[:, None] != room_of[None, :])
        between_m += DOOR_M * (room_of[:, None] != room_of[None, :])
    stays_m = ROOM_STAY_M + WORK_M_PER_M2 * shares_m2[columns]
    return _firsts(situation, columns, Places(first_m, between_m, weights[columns], stays_m, FAR_M))


def meetings_m(situation: Situation) -> NDArray[np.float64]:
    """Path length lost to oncoming robots on the path to each frontier, (seekers, frontiers), metres.

    Two paths, from a to b and from c to d, run against each other over half of ab + cd − ad − cb. This holds if the
    paths between all of them form a tree, as they nearly do in a building of rooms and corridors.
    """
    paths_m = np.concatenate([situation.paths_m, situation.busy_paths_m])
    goals = [*(seeker.goal for seeker in situation.seekers), *(robot.goal for robot in situation.busy)]
    lost_m = np.zeros_like(situation.paths_m)
    for teammate, goal in enumerate(goals):
        column = None if goal is None else situation.column_of(goal)
        if column is None or not np.isfinite(paths_m[teammate, column]):
            continue
        own_m = situation.paths_m
        with np.errstate(invalid="ignore"):
            against_m = 0.5 * (own_m + paths_m[teammate, column] - own_m[:, column, None] - paths_m[teammate])
        against_m = np.where(np.isfinite(against_m), against_m, 0.0)
        if teammate < len(own_m):
            against_m[teammate] = 0.0
        lost_m += MEET_M * np.clip(against_m / MEET_OVER_M, 0.0, 1.0)
    return lost_m


TOUR_ROBOTS = 4
"""Largest number of robots that are sent on tours. With the full stack, four robots know 95 % of five floors after 42.2
s on average by tours and 44.6 s jointly. Eight robots know three floors after 43.9 s and 44.4 s (decision 0046)."""
ROOM_ROBOTS = 3
"""Least number of robots that are sent by rooms: one and two are slower so (decisions 0047, 0058 and 0063)."""
SMALL_ROOMS_M2 = 45.0
"""Area of the room around a place, mean over the known floor, below which rooms are small. Measured while a floor is
explored: up to 40 m² in a clinic and up to 48 m² in a hospital section. The area is 45 to 69 m² in a laboratory, 40 to
74 m² in an office, 44 to 99 m² in a hospital. In the end it is above 75 m² in a cave and above 190 m² in a depot
(decision 0058)."""

KNOWN_M2 = 150.0
"""Known floor below which more than four robots are not sent by rooms: at first every building seems to have small ones
(chosen: decision 0063)."""


def auto(situation: Situation) -> list[Choice]:
    """Choose by `rooms` for three robots and more where rooms are small, else by `tours`, or by `joint` for many."""
    robots = len(situation.seekers) + len(situation.busy)
    floor = situation.floor
    is_many = robots > TOUR_ROBOTS
    is_reported = floor is not None and (not is_many or floor.known_m2 > KNOWN_M2)
    if robots >= ROOM_ROBOTS and floor is not None and is_reported and floor.room_m2 < SMALL_ROOMS_M2:
        return rooms(situation)
    return joint(situation) if is_many else tours(situation)
