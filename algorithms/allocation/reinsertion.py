"""A search for routes where time has a price, which PyVRP's model does not know: remove visits and insert them again.

Each step removes some visits, near each other or at random, and inserts them in random order where they cost least. The
result stays if it is no worse. Source: Shaw, Using Constraint Programming and Local Search Methods to Solve Vehicle
Routing Problems, CP 1998 (large neighbourhood search).
"""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.allocation.allocator import Effort
from robrain.algorithms.allocation.insertion import (
    BY_ENERGY,
    SLACK_J,
    RouteBatch,
    cheapest_insertion,
    cheapest_pair,
    empty_routes,
    insert,
    refresh,
    remove,
)
from robrain.algorithms.allocation.problem import Floats, TeamArrays, VisitArrays

MOST_REMOVED = 10
NEAR_SHARE = 0.7
"""Share of the steps that remove visits near each other (chosen)."""
STEPS = 5
"""Steps that count as one iteration."""
PATIENCE = 100
"""Iterations without improvement after which a search ends."""
REQUIRED_J = 1e12


class Reinsertion:
    """Searches of one problem.

    Args:
        team: of the problem.
        visits: likewise, possibly with narrower windows (see `coupling.py`).
        required: (V,) visits that must be made.

    """

    def __init__(self, team: TeamArrays, visits: VisitArrays, required: NDArray[np.bool_]) -> None:
        self._team, self._visits = team, visits
        self._prize_j = np.where(required, REQUIRED_J, visits.prize_j)

    def run(
        self, orders: Sequence[Sequence[int]], effort: Effort, seed: int, *, end_left_s: float = 0.0
    ) -> list[list[int]]:
        """Return the visits of each worker in order.

        Args:
            orders: visits to begin with.
            effort: stops the search, and is spent by it.
            seed: of the search.
            end_left_s: stop when no more than this remains of the deadline.

        """
        routes = empty_routes(self._team, self._visits)
        is_open = np.ones(len(self._visits.job), np.bool_)
        for worker, order in enumerate(orders):
            routes.order[worker, : len(order)], routes.length[worker] = order, len(order)
            is_open[list(order)] = False
            refresh(self._team, self._visits, routes, worker)
        rng = np.random.default_rng(seed)
        fruitless, longest_s = 0, 0.0
        while fruitless < PATIENCE and effort.left_iterations > 0:
            left_s = effort.left_s
            if left_s <= end_left_s + 1.5 * longest_s:
                break
            is_better = reinsert(self._team, self._visits, self._prize_j, routes, is_open, STEPS, rng)
            fruitless = 0 if is_better else fruitless + 1
            effort.spend()
            longest_s = max(longest_s, left_s - effort.left_s) if math.isfinite(left_s) else 0.0
        return [routes.order[worker, :length].tolist() for worker, length in enumerate(routes.length)]


@njit(cache=True, nogil=True)
def reinsert(
    team: TeamArrays,
    visits: VisitArrays,
    prize_j: Floats,
    routes: RouteBatch,
    is_open: NDArray[np.bool_],
    steps: int,
    rng: np.random.Generator,
) -> bool:
    """Take some steps; changes `routes` and `is_open`, the (V,) visits on no route, in place.

    Returns: Whether the joules, delays and prizes that are not collected have become less.

    """
    workers = len(routes.length)
    is_better = False
    old_order, old_length, old_open = routes.order.copy(), routes.length.copy(), is_open.copy()
    costs_j = np.array([_cost_j(visits, routes, worker) for worker in range(workers)])
    for _ in range(steps):
        now_j = costs_j.sum() + prize_j[is_open].sum()
        _remove_some(team, visits, routes, is_open, rng)
        for visit in rng.permutation(np.flatnonzero(is_open & (visits.pickup < 0))):
            _insert_cheapest(team, visits, prize_j, routes, is_open, visit)
        new_j = prize_j[is_open].sum()
        for worker in range(workers):
            new_j += _cost_j(visits, routes, worker)
        is_kept = new_j <= now_j
        is_better |= new_j < now_j - SLACK_J
        for worker in range(workers):
            length = routes.length[worker]
            if length == old_length[worker] and (routes.order[worker, :length] == old_order[worker, :length]).all():
                continue
            if is_kept:
                old_order[worker], old_length[worker] = routes.order[worker], length
                costs_j[worker] = _cost_j(visits, routes, worker)
            else:
                routes.order[worker], routes.length[worker] = old_order[worker], old_length[worker]
                refresh(team, visits, routes, worker)
        if is_kept:
            old_open[:] = is_open
        else:
            is_open[:] = old_open
    return is_better


@njit(cache=True, nogil=True)
def _cost_j(visits: VisitArrays, routes: RouteBatch, worker: int) -> float:
    cost_j = routes.spent_j[worker]
    for position in range(routes.length[worker]):
        cost_j += visits.delay_w[routes.order[worker, position]] * routes.leave_s[worker, position + 1]
    return float(cost_j)


@njit(cache=True, nogil=True)
def _remove_some(
    team: TeamArrays, visits: VisitArrays, routes: RouteBatch, is_open: NDArray[np.bool_], rng: np.random.Generator
) -> None:
    count = len(visits.job)
    size = min(count, 2 + int(rng.random() * (MOST_REMOVED - 1)))
    if rng.random() < NEAR_SHARE:
        seed = visits.place[int(rng.random() * count)]
        near_j = np.array([team.energy_j[0, seed, place] for place in visits.place])
        candidates = rng.permutation(np.argsort(near_j, kind="mergesort")[: 2 * size])
    else:
        candidates = rng.permutation(count)
    is_gone = np.zeros(count, np.bool_)
    for visit in candidates[:size]:
        for one in (visit, visits.delivery[visit], visits.pickup[visit]):
            if one >= 0:
                is_gone[one] = True
    is_open |= is_gone
    for worker in range(len(routes.length)):
        for position in range(routes.length[worker] - 1, -1, -1):
            if is_gone[routes.order[worker, position]]:
                remove(team, visits, routes, worker, position)


@njit(cache=True, nogil=True)
def _insert_cheapest(
    team: TeamArrays,
    visits: VisitArrays,
    prize_j: Floats,
    routes: RouteBatch,
    is_open: NDArray[np.bool_],
    visit: int,
) -> None:
    """Insert a visit, with its delivery, where the bid is least, unless it costs more than its prize."""
    delivery = visits.delivery[visit]
    best_bid, taker, best_position, best_later = math.inf, -1, -1, -1
    for worker in range(len(routes.length)):
        later = -1
        if delivery >= 0:
            bid, more_j, position, later = cheapest_pair(team, visits, routes, worker, visit, BY_ENERGY, 0)
        else:
            bid, more_j, position = cheapest_insertion(team, visits, routes, worker, visit, BY_ENERGY)
        if bid < best_bid and more_j < prize_j[visit]:
            best_bid, taker, best_position, best_later = bid, worker, position, later
    if taker < 0:
        return
    insert(team, visits, routes, taker, visit, best_position)
    is_open[visit] = False
    if delivery >= 0:
        insert(team, visits, routes, taker, delivery, best_later)
        is_open[delivery] = False
