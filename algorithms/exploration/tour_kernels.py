"""Tours through weighted places that reach them early: compiled.

The sum over all places of weight times way until it is reached is made small (minimum latency, "travelling repairman"
with several men): insertion of the place that adds least, then moves of single places and reversals of stretches.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

ROUNDS = 20
"""Rounds of moves at most; almost all are settled after five."""
LEAST_SAVING = 1e-6
"""A move has to save this, so that rounding never makes two tours change places for ever."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Places(NamedTuple):
    """What is to be visited."""

    first_m: Floats
    """Way of each robot to each place (robots, places), metres; inf where there is none."""
    between_m: Floats
    """Ways between the places (places, places)."""
    weights: Floats
    """What it is worth to reach each place early (places,), above 0."""
    stay_m: Floats
    """Way that could be made in the time which each place takes (places,)."""
    far_m: float
    """A way of this length counts for half of what it would; longer ones for less and less."""


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
    """A tour for each robot; every place that some robot can reach is in one of them.

    Raises:
        ValueError: shapes that do not fit each other.

    """
    robots, count = places.first_m.shape
    shapes = places.between_m.shape, places.weights.shape, places.stay_m.shape
    if shapes != ((count, count), (count,), (count,)):
        raise ValueError(f"expected {count} places, got ways, weights and stays of shapes {shapes}")
    exact = Places(
        np.ascontiguousarray(places.first_m, np.float64),
        np.ascontiguousarray(places.between_m, np.float64),
        np.ascontiguousarray(places.weights, np.float64),
        np.ascontiguousarray(places.stay_m, np.float64),
        float(places.far_m),
    )
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
    """Sum of weight times way of one tour; inf if it cannot be driven."""
    way_m, cost = 0.0, 0.0
    for index in range(length):
        place = tour[index]
        way_m += places.first_m[robot, place] if index == 0 else places.between_m[tour[index - 1], place]
        cost += places.weights[place] * way_m * places.far_m / (way_m + places.far_m)
        way_m += places.stay_m[place]
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
    """What the best insertion of a place adds, with its robot and position; inf if no robot can reach it."""
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
def _take(tours: Tours, robot: int, position: int) -> None:
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
            _take(tours, robot, position)
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
