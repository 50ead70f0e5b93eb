"""Routes under construction, and the cost of inserting a visit: the compiled kernels of the auctions."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.allocation.problem import SLACK_KG, Floats, Indices, TeamArrays, VisitArrays

SLACK_J = 1e-6
"""Tolerance for sums of joules, against rounding that depends on the order of summation."""
SLACK_S = 1e-6

BY_ENERGY, BY_FINISH, BY_LEAST_LEFT = 0, 1, 2


class RouteBatch(NamedTuple):
    """W routes of up to V visits."""

    order: NDArray[np.int32]
    """(W, V) visits in order; entries beyond a route's length are undefined."""
    length: Indices
    """(W,)"""
    leave_s: Floats
    """(W, V + 1) departure from the start (column 0) and from each visit."""
    late_s: Floats
    """(W, V + 1) latest arrival at each visit, then at the charger, that keeps all later visits in time."""
    spent_j: Floats
    """(W,) including the path to the charger and waiting; 0 for an empty route."""
    wait_s: Floats
    end_s: Floats
    """(W,) arrival at the charger; `ready_s` for an empty route."""
    load_kg: Floats
    """(W, V + 1) load at the start (column 0) and after each visit."""
    delay_w: Floats
    """(W, V + 1) of each visit and those after it."""


def empty_routes(team: TeamArrays, visits: VisitArrays) -> RouteBatch:
    """Routes without visits."""
    workers, count = visits.allowed.shape
    routes = RouteBatch(
        np.zeros((workers, count), np.int32),
        np.zeros(workers, np.int64),
        np.zeros((workers, count + 1)),
        np.zeros((workers, count + 1)),
        np.zeros(workers),
        np.zeros(workers),
        np.zeros(workers),
        np.zeros((workers, count + 1)),
        np.zeros((workers, count + 1)),
    )
    for worker in range(workers):
        refresh(team, visits, routes, worker)
    return routes


@njit(cache=True, nogil=True)
def refresh(team: TeamArrays, visits: VisitArrays, routes: RouteBatch, worker: int) -> None:
    """Recompute one route's times and energy."""
    profile = team.profile[worker]
    length = routes.length[worker]
    place = team.start[worker]
    now_s = team.ready_s[worker]
    spent_j = 0.0
    wait_s = 0.0
    routes.leave_s[worker, 0] = now_s
    routes.load_kg[worker, 0] = team.load_kg[worker]
    for position in range(length):
        visit = routes.order[worker, position]
        now_s += team.time_s[profile, place, visits.place[visit]]
        spent_j += team.energy_j[profile, place, visits.place[visit]] + visits.service_j[visit]
        place = visits.exit_place[visit]
        if now_s < visits.earliest_s[visit]:
            wait_s += visits.earliest_s[visit] - now_s
            now_s = visits.earliest_s[visit]
        now_s += visits.service_s[visit]
        routes.leave_s[worker, position + 1] = now_s
        routes.load_kg[worker, position + 1] = routes.load_kg[worker, position] + visits.load_kg[visit]
    if length > 0:
        now_s += team.end_s[worker, place]
        spent_j += team.end_j[worker, place] + wait_s * team.wait_w[worker]
    routes.spent_j[worker] = spent_j
    routes.wait_s[worker] = wait_s
    routes.end_s[worker] = now_s
    late_s = team.horizon_s
    routes.late_s[worker, length] = late_s
    routes.delay_w[worker, length] = 0.0
    for position in range(length - 1, -1, -1):
        visit = routes.order[worker, position]
        here = visits.exit_place[visit]
        if position == length - 1:
            late_s -= team.end_s[worker, here]
        else:
            late_s -= team.time_s[profile, here, visits.place[routes.order[worker, position + 1]]]
        late_s = min(late_s - visits.service_s[visit], visits.latest_s[visit])
        routes.late_s[worker, position] = late_s
        routes.delay_w[worker, position] = routes.delay_w[worker, position + 1] + visits.delay_w[visit]


@njit(cache=True, nogil=True)
def insert(team: TeamArrays, visits: VisitArrays, routes: RouteBatch, worker: int, visit: int, position: int) -> None:
    """Insert a visit into a route."""
    for index in range(routes.length[worker], position, -1):
        routes.order[worker, index] = routes.order[worker, index - 1]
    routes.order[worker, position] = visit
    routes.length[worker] += 1
    refresh(team, visits, routes, worker)


@njit(cache=True, nogil=True)
def _finish(
    team: TeamArrays, visits: VisitArrays, routes: RouteBatch, worker: int, place: int, now_s: float, position: int
) -> tuple[float, float]:
    """Arrival at the charger, and seconds of waiting, for a worker that leaves `place` for the visit at `position`."""
    profile = team.profile[worker]
    wait_s = 0.0
    for index in range(position, routes.length[worker]):
        visit = routes.order[worker, index]
        now_s += team.time_s[profile, place, visits.place[visit]]
        place = visits.exit_place[visit]
        if now_s < visits.earliest_s[visit]:
            wait_s += visits.earliest_s[visit] - now_s
            now_s = visits.earliest_s[visit]
        now_s += visits.service_s[visit]
    return now_s + team.end_s[worker, place], wait_s


@njit(cache=True, nogil=True)
def insertion_at(
    team: TeamArrays, visits: VisitArrays, routes: RouteBatch, worker: int, visit: int, position: int, rule: int
) -> tuple[float, float]:
    """Cost of inserting a visit at a position of a worker's route. The load of a pickup with a delivery is not checked.

    Returns: The bid by the rule (additional joules and delays, time of return, or minus the remaining energy) and the
        additional joules. Both are infinite if a visit would be late, the load is too large or there is no path. If
        only the energy does not suffice, the bid is infinite. Delays count as if no later visit waited for its
        earliest start.

    """
    if visits.delivery[visit] < 0 and not carries(team, routes, worker, position, visits.load_kg[visit]):
        return math.inf, math.inf
    profile = team.profile[worker]
    length = routes.length[worker]
    here, leaves_from = visits.place[visit], visits.exit_place[visit]
    place = team.start[worker] if position == 0 else visits.exit_place[routes.order[worker, position - 1]]
    if position == length:
        back_s = team.end_s[worker, leaves_from]
        old_s = team.end_s[worker, place]
        more_j = team.end_j[worker, leaves_from]
        if length > 0:
            more_j -= team.end_j[worker, place]
    else:
        following = visits.place[routes.order[worker, position]]
        back_s = team.time_s[profile, leaves_from, following]
        old_s = team.time_s[profile, place, following]
        more_j = team.energy_j[profile, leaves_from, following] - team.energy_j[profile, place, following]
    more_j += team.energy_j[profile, place, here] + visits.service_j[visit]
    arrive_s = routes.leave_s[worker, position] + team.time_s[profile, place, here]
    start_s = max(arrive_s, visits.earliest_s[visit])
    leave_s = start_s + visits.service_s[visit]
    if not (
        more_j < math.inf
        and start_s <= visits.latest_s[visit] + SLACK_S
        and leave_s + back_s <= routes.late_s[worker, position] + SLACK_S
    ):
        return math.inf, math.inf
    end_s = routes.end_s[worker]
    wait_j = routes.wait_s[worker] * team.wait_w[worker]
    if routes.wait_s[worker] > 0 or team.wait_w[worker] > 0:
        end_s, wait_s = _finish(team, visits, routes, worker, leaves_from, leave_s, position)
        wait_s += start_s - arrive_s
        for index in range(position):
            before = routes.order[worker, index]
            wait_s += max(0.0, visits.earliest_s[before] - _arrival(team, visits, routes, worker, index))
        more_j += wait_s * team.wait_w[worker] - wait_j
    elif length > 0:
        end_s += leave_s + back_s - routes.leave_s[worker, position] - old_s
    else:
        end_s = leave_s + back_s
    spent_j = routes.spent_j[worker] + more_j
    if not spent_j <= team.usable_j[worker] + SLACK_J:
        return math.inf, more_j
    if rule == BY_ENERGY:
        delay_j = visits.delay_w[visit] * leave_s
        if routes.delay_w[worker, position] > 0:
            delay_j += routes.delay_w[worker, position] * (leave_s + back_s - routes.leave_s[worker, position] - old_s)
        return more_j + delay_j, more_j
    return (end_s, more_j) if rule == BY_FINISH else (spent_j - team.usable_j[worker], more_j)


@njit(cache=True, nogil=True)
def cheapest_insertion(
    team: TeamArrays, visits: VisitArrays, routes: RouteBatch, worker: int, visit: int, rule: int
) -> tuple[float, float, int]:
    """The best position of a visit in a worker's route: bid, additional joules, position; −1 if there is none."""
    best_bid, best_more_j, best_position = math.inf, math.inf, -1
    if visits.allowed[worker, visit]:
        for position in range(routes.length[worker] + 1):
            bid, more_j = insertion_at(team, visits, routes, worker, visit, position, rule)
            if bid < best_bid or (bid == best_bid and bid < math.inf and more_j < best_more_j):
                best_bid, best_more_j, best_position = bid, more_j, position
    return best_bid, best_more_j, best_position


@njit(cache=True, nogil=True)
def cheapest_pair(
    team: TeamArrays, visits: VisitArrays, routes: RouteBatch, worker: int, visit: int, rule: int, first: int
) -> tuple[float, float, int, int]:
    """The best positions of a pickup and its delivery in a worker's route, from position `first` on.

    Returns: Bid, additional joules, position of the pickup, and that of the delivery after the pickup's insertion. The
        positions are −1 if there are none. The bid is infinite, and the additional joules are not, if only the energy
        does not suffice.

    """
    best_bid, best_more_j, best_position, best_later = math.inf, math.inf, -1, -1
    delivery = visits.delivery[visit]
    if not visits.allowed[worker, visit]:
        return best_bid, best_more_j, best_position, best_later
    for position in range(first, routes.length[worker] + 1):
        pickup_bid, pickup_j = insertion_at(team, visits, routes, worker, visit, position, BY_ENERGY)
        if not pickup_j < math.inf:
            continue
        insert(team, visits, routes, worker, visit, position)
        for later in range(position + 1, routes.length[worker] + 1):
            if not is_load(team, worker, routes.load_kg[worker, later]):
                break
            bid, more_j = insertion_at(team, visits, routes, worker, delivery, later, rule)
            more_j += pickup_j
            if rule == BY_ENERGY:
                bid += pickup_bid
            if bid < best_bid or (bid == best_bid and more_j < best_more_j):
                best_bid, best_more_j, best_position, best_later = bid, more_j, position, later
        remove(team, visits, routes, worker, position)
    return best_bid, best_more_j, best_position, best_later


@njit(cache=True, nogil=True)
def is_load(team: TeamArrays, worker: int, load_kg: float) -> bool:
    """Whether a worker can carry this load."""
    return bool(-SLACK_KG <= load_kg <= team.capacity_kg[worker] + SLACK_KG)


@njit(cache=True, nogil=True)
def carries(team: TeamArrays, routes: RouteBatch, worker: int, position: int, more_kg: float) -> bool:
    """Whether a worker can carry `more_kg` from a position of its route to the end."""
    if more_kg != 0:
        for index in range(position, routes.length[worker] + 1):
            if not is_load(team, worker, routes.load_kg[worker, index] + more_kg):
                return False
    return True


@njit(cache=True, nogil=True)
def _arrival(team: TeamArrays, visits: VisitArrays, routes: RouteBatch, worker: int, position: int) -> float:
    visit = routes.order[worker, position]
    place = team.start[worker] if position == 0 else visits.exit_place[routes.order[worker, position - 1]]
    arrive_s: float = routes.leave_s[worker, position] + team.time_s[team.profile[worker], place, visits.place[visit]]
    return arrive_s


@njit(cache=True, nogil=True)
def position_of(routes: RouteBatch, worker: int, visit: int) -> int:
    """The position of a visit in a worker's route; −1 if it is not there."""
    for position in range(routes.length[worker]):
        if routes.order[worker, position] == visit:
            return position
    return -1


@njit(cache=True, nogil=True)
def remove(team: TeamArrays, visits: VisitArrays, routes: RouteBatch, worker: int, position: int) -> None:
    """Remove the visit at a position from a route."""
    for index in range(position, routes.length[worker] - 1):
        routes.order[worker, index] = routes.order[worker, index + 1]
    routes.length[worker] -= 1
    refresh(team, visits, routes, worker)
