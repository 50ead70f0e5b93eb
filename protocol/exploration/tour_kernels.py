"""Tours through weighted places that reach them early: compiled.

The sum over all places of weight times way until it is reached is made small (minimum latency, "travelling repairman"
with several men): insertion of the place that adds least, then moves of single places and reversals of stretches.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

ROUNDS = 20
"""Rounds of moves at most; almost all are settled after five."""
LEAST_SAVING = 1e-6
"""A move has to save this, so that rounding never makes two tours change places for ever."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def plan_tours(first_m: Floats, between_m: Floats, weights: Floats, stay_m: float, far_m: float) -> list[list[int]]:
    """A tour for each robot; every place that some robot can reach is in one of them.

    Args:
        first_m: way of each robot to each place (robots, places), metres; inf where there is none.
        between_m: ways between the places (places, places).
        weights: what it is worth to reach each place early (places,), above 0.
        stay_m: way that could be made in the time which a place takes.
        far_m: a way of this length counts for half of what it would; longer ones for less and less.

    Raises:
        ValueError: shapes that do not fit each other.

    """
    robots, places = first_m.shape
    if between_m.shape != (places, places) or weights.shape != (places,):
        raise ValueError(f"expected {places} places, got ways {between_m.shape} and weights {weights.shape}")
    tours, lengths = _plan(
        np.ascontiguousarray(first_m, np.float64),
        np.ascontiguousarray(between_m, np.float64),
        np.ascontiguousarray(weights, np.float64),
        float(stay_m),
        float(far_m),
    )
    return [tours[robot, : lengths[robot]].tolist() for robot in range(robots)]


@njit(cache=True, nogil=True)
def _cost(
    first_m: Floats,
    between_m: Floats,
    weights: Floats,
    stay_m: float,
    far_m: float,
    robot: int,
    tour: Ints,
    length: int,
) -> float:
    """Sum of weight times way of one tour; inf if it cannot be driven."""
    way_m, cost = 0.0, 0.0
    for index in range(length):
        place = tour[index]
        way_m += first_m[robot, place] if index == 0 else between_m[tour[index - 1], place]
        cost += weights[place] * way_m * far_m / (way_m + far_m)
        way_m += stay_m
    return cost


@njit(cache=True, nogil=True)
def _insert(tour: Ints, length: int, place: int, position: int, into: Ints) -> None:
    for index in range(position):
        into[index] = tour[index]
    into[position] = place
    for index in range(position, length):
        into[index + 1] = tour[index]


@njit(cache=True, nogil=True)
def _best_insertion(
    first_m: Floats,
    between_m: Floats,
    weights: Floats,
    stay_m: float,
    far_m: float,
    place: int,
    tours: Ints,
    lengths: Ints,
    costs: Floats,
    tried: Ints,
) -> tuple[float, int, int]:
    """What the best insertion of a place adds, with its robot and position; inf if no robot can reach it."""
    best, best_robot, best_position = np.inf, -1, -1
    for robot in range(first_m.shape[0]):
        if first_m[robot, place] == np.inf:
            continue
        for position in range(lengths[robot] + 1):
            _insert(tours[robot], lengths[robot], place, position, tried)
            added = _cost(first_m, between_m, weights, stay_m, far_m, robot, tried, lengths[robot] + 1) - costs[robot]
            if added < best:
                best, best_robot, best_position = added, robot, position
    return best, best_robot, best_position


@njit(cache=True, nogil=True)
def _put(tours: Ints, lengths: Ints, robot: int, place: int, position: int) -> None:
    for index in range(lengths[robot], position, -1):
        tours[robot, index] = tours[robot, index - 1]
    tours[robot, position] = place
    lengths[robot] += 1


@njit(cache=True, nogil=True)
def _take(tours: Ints, lengths: Ints, robot: int, position: int) -> None:
    for index in range(position + 1, lengths[robot]):
        tours[robot, index - 1] = tours[robot, index]
    lengths[robot] -= 1


@njit(cache=True, nogil=True)
def _move_places(
    first_m: Floats,
    between_m: Floats,
    weights: Floats,
    stay_m: float,
    far_m: float,
    tours: Ints,
    lengths: Ints,
    costs: Floats,
    tried: Ints,
) -> bool:
    """Move places to where they add less, each once; whether any was moved."""
    is_better = False
    for robot in range(first_m.shape[0]):
        position = 0
        while position < lengths[robot]:
            place, before = tours[robot, position], costs[robot]
            _take(tours, lengths, robot, position)
            costs[robot] = _cost(first_m, between_m, weights, stay_m, far_m, robot, tours[robot], lengths[robot])
            saved = before - costs[robot]
            added, to_robot, to_position = _best_insertion(
                first_m, between_m, weights, stay_m, far_m, place, tours, lengths, costs, tried
            )
            if added < saved - LEAST_SAVING:
                _put(tours, lengths, to_robot, place, to_position)
                costs[to_robot] += added
                is_better = True
            else:
                _put(tours, lengths, robot, place, position)
                costs[robot] = before
                position += 1
    return is_better


@njit(cache=True, nogil=True)
def _reverse_stretches(
    first_m: Floats,
    between_m: Floats,
    weights: Floats,
    stay_m: float,
    far_m: float,
    tours: Ints,
    lengths: Ints,
    costs: Floats,
    tried: Ints,
) -> bool:
    """Reverse stretches of tours where that saves; whether any was reversed."""
    is_better = False
    for robot in range(first_m.shape[0]):
        length = lengths[robot]
        for start in range(length - 1):
            for end in range(start + 1, length):
                for index in range(length):
                    is_within = start <= index <= end
                    tried[index] = tours[robot, start + end - index if is_within else index]
                if first_m[robot, tried[0]] == np.inf:
                    continue
                cost = _cost(first_m, between_m, weights, stay_m, far_m, robot, tried, length)
                if cost < costs[robot] - LEAST_SAVING:
                    tours[robot, :length] = tried[:length]
                    costs[robot] = cost
                    is_better = True
    return is_better


@njit(cache=True, nogil=True)
def _plan(first_m: Floats, between_m: Floats, weights: Floats, stay_m: float, far_m: float) -> tuple[Ints, Ints]:
    robots, places = first_m.shape
    tours, lengths = np.full((robots, places + 1), -1, np.int64), np.zeros(robots, np.int64)
    costs, tried = np.zeros(robots), np.empty(places + 1, np.int64)
    is_open = np.ones(places, np.bool_)
    while True:
        least, found_place, found_robot, found_position = np.inf, -1, -1, -1
        for place in range(places):
            if is_open[place]:
                added, robot, position = _best_insertion(
                    first_m, between_m, weights, stay_m, far_m, place, tours, lengths, costs, tried
                )
                if added < least:
                    least, found_place, found_robot, found_position = added, place, robot, position
        if found_place < 0:
            break
        _put(tours, lengths, found_robot, found_place, found_position)
        costs[found_robot] += least
        is_open[found_place] = False
    for _ in range(ROUNDS):
        is_moved = _move_places(first_m, between_m, weights, stay_m, far_m, tours, lengths, costs, tried)
        is_reversed = _reverse_stretches(first_m, between_m, weights, stay_m, far_m, tours, lengths, costs, tried)
        if not (is_moved or is_reversed):
            break
    return tours, lengths
