"""A search for routes with charges between visits: ruin and recreate.

Each step removes strings of neighbouring visits from neighbouring routes and inserts them again where they cost least,
now and then skipping the best position. Simulated annealing accepts or rejects the result. Source: Christiaens, Vanden
Berghe: Slack Induction by String Removals for Vehicle Routing Problems, Transportation Science 54(2), 2020. A visit may
be inserted together with a charger before it, after it, or both. Afterwards `recharging.py` places the charges of all
changed routes again.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.allocation.allocator import Effort
from robrain.algorithms.allocation.charging_tours import (
    KG,
    LATE_S,
    LEAST_KG,
    LEAVE_S,
    MOST_KG,
    ChargingTours,
    best_at,
    empty_tours,
    insert,
    recharge,
    refresh,
)
from robrain.algorithms.allocation.insertion import SLACK_J, SLACK_S
from robrain.algorithms.allocation.problem import SLACK_KG, Floats, Indices, TeamArrays, VisitArrays
from robrain.algorithms.allocation.recharging import (
    CAPACITY_KG,
    EARLIEST_S,
    LATEST_S,
    LOAD_KG,
    PROFILE,
    SERVICE_S,
    ChargingGraph,
    charging_graph,
    place_charges,
)

MEAN_REMOVED = 10
LONGEST_STRING = 10
SPLIT_SHARE = 0.5
SPLIT_DEPTH = 0.01
BLINK = 0.01
"""As in the paper: mean number of visits removed, longest string, and probabilities."""


@njit(cache=True, nogil=True)
def _remove(
    graph: ChargingGraph,
    horizon_s: float,
    pair: Indices,
    tours: ChargingTours,
    worker: int,
    absent: NDArray[np.bool_],
    gone: NDArray[np.bool_],
) -> None:
    """Remove the visits marked in `gone`, and their other halves, from a route."""
    count, size = len(pair), 0
    order = tours.order[worker]
    for position in range(tours.length[worker]):
        entry = order[position]
        if entry < count and (gone[entry] or (pair[entry] >= 0 and gone[pair[entry]])):
            absent[entry] = True
            continue
        order[size] = entry
        size += 1
    tours.length[worker] = size
    refresh(graph, horizon_s, tours, worker)


@njit(cache=True, nogil=True)
def ruin(
    graph: ChargingGraph,
    horizon_s: float,
    pair: Indices,
    tours: ChargingTours,
    neighbours: NDArray[np.int32],
    absent: NDArray[np.bool_],
    is_changed: NDArray[np.bool_],
    rng: np.random.Generator,
    order: NDArray[np.int32],
    found: NDArray[np.int32],
) -> None:
    """Remove strings of visits near a random visit; marks absent visits and changed routes."""
    count, workers = len(pair), len(tours.length)
    route_of = np.full(count, -1)
    place_of = np.zeros(count, np.int64)
    sizes = np.zeros(workers, np.int64)
    for worker in range(workers):
        for position in range(tours.length[worker]):
            entry = tours.order[worker, position]
            if entry < count:
                route_of[entry], place_of[entry] = worker, sizes[worker]
                sizes[worker] += 1
    used = max(1, int((sizes > 0).sum()))
    longest = min(float(LONGEST_STRING), max(1.0, sizes.sum() / used))
    strings = int(rng.random() * (4.0 * MEAN_REMOVED / (1.0 + longest) - 1.0)) + 1
    gone = np.zeros(count, np.bool_)
    seed = int(rng.random() * count)
    for neighbour in neighbours[seed]:
        worker = route_of[neighbour]
        if worker < 0 or is_changed[worker]:
            continue
        size = sizes[worker]
        most = int(min(float(size), longest))
        string = int(rng.random() * most) + 1
        kept = 0
        if string > 1 and string < size and rng.random() < SPLIT_SHARE:
            kept = 1
            while string + kept < size and rng.random() < SPLIT_DEPTH:
                kept += 1
        whole = string + kept
        lowest = max(0, place_of[neighbour] - whole + 1)
        highest = min(size - whole, place_of[neighbour])
        begin = lowest + int(rng.random() * (highest - lowest + 1))
        kept_from = begin + int(rng.random() * (string + 1)) if kept else size
        for position in range(tours.length[worker]):
            entry = tours.order[worker, position]
            if entry < count:
                at = place_of[entry]
                if begin <= at < begin + whole and not kept_from <= at < kept_from + kept:
                    gone[entry] = True
        is_changed[worker] = True
        _remove(graph, horizon_s, pair, tours, worker, absent, gone)
        recharge(graph, horizon_s, tours, worker, order, found)
        strings -= 1
        if strings <= 0:
            return


class Inserted(NamedTuple):
    """V visits to be inserted into the routes of W workers."""

    pair: Indices
    """(V,) the other half of a pickup and delivery; -1 if there is none."""
    is_delivery: NDArray[np.bool_]
    """(V,) whether the visit is inserted with its pickup."""
    prize_j: Floats
    """(V,)"""
    allowed: NDArray[np.bool_]
    """(W, V)"""
    kinds: Indices
    """(W,) equal for workers that do not differ."""
    far_j: Floats
    """(V,) joules from the nearest start."""


@njit(cache=True, nogil=True)
def _ranked(graph: ChargingGraph, inserted: Inserted, rows: Indices, rng: np.random.Generator) -> Indices:
    """Visits in the order of their insertion, by a random rule. Source: as above, section 5.3."""
    keys = np.empty(len(rows))
    choice = rng.random() * 17.0
    for index, visit in enumerate(rows):
        figures = graph.nodes[visit]
        if choice < 4.0:
            keys[index] = rng.random()
        elif choice < 8.0:
            keys[index] = -abs(figures[LOAD_KG])
        elif choice < 10.0:
            keys[index] = -inserted.far_j[visit]
        elif choice < 11.0:
            keys[index] = inserted.far_j[visit]
        elif choice < 13.0:
            keys[index] = figures[LATEST_S] - figures[EARLIEST_S]
        elif choice < 15.0:
            keys[index] = figures[EARLIEST_S]
        else:
            keys[index] = -figures[LATEST_S]
    return rows[np.argsort(keys, kind="mergesort")]


@njit(cache=True, nogil=True)
def recreate(
    graph: ChargingGraph,
    horizon_s: float,
    inserted: Inserted,
    tours: ChargingTours,
    absent: NDArray[np.bool_],
    is_changed: NDArray[np.bool_],
    rng: np.random.Generator,
    saved: NDArray[np.int32],
) -> None:
    """Insert absent visits where they cost least; visits that cost more than their prize stay absent."""
    workers, most = tours.order.shape
    is_tried = np.empty(workers, np.bool_)
    for visit in _ranked(graph, inserted, np.flatnonzero(absent & ~inserted.is_delivery), rng):
        delivery, load_kg = inserted.pair[visit], graph.nodes[visit, LOAD_KG]
        earliest_s = graph.nodes[visit, EARLIEST_S] + graph.nodes[visit, SERVICE_S]
        best_j = inserted.prize_j[visit]
        best_worker = best_position = best_first = best_last = best_later = later_first = later_last = -1
        is_tried[:] = False
        for worker in range(workers):
            length = tours.length[worker]
            if not inserted.allowed[worker, visit] or length + 6 > most:
                continue
            if length == 0:
                if is_tried[inserted.kinds[worker]]:
                    continue
                is_tried[inserted.kinds[worker]] = True
            room_kg = graph.workers[worker, CAPACITY_KG] - load_kg + SLACK_KG
            leg_s = graph.leg_s[int(graph.workers[worker, PROFILE])]
            for position in range(length + 1):
                if rng.random() < BLINK:
                    continue
                if tours.figures[worker, position, LEAVE_S] > graph.nodes[visit, LATEST_S]:
                    break
                if position < length and earliest_s + leg_s[visit, tours.order[worker, position]] > (
                    tours.figures[worker, position, LATE_S] + SLACK_S
                ):
                    continue
                figures = tours.figures[worker, position]
                if delivery < 0 and not (figures[MOST_KG] <= room_kg and figures[LEAST_KG] + load_kg >= -SLACK_KG):
                    continue
                if delivery >= 0 and figures[KG] > room_kg:
                    continue
                more_j, first, last = best_at(graph, tours, worker, position, visit, best_j)
                if not more_j < best_j:
                    continue
                if delivery < 0:
                    best_j, best_worker, best_position, best_first, best_last = more_j, worker, position, first, last
                    continue
                saved[:length] = tours.order[worker, :length]
                at = insert(graph, horizon_s, tours, worker, position, first, visit, last)
                for later in range(at + 1, tours.length[worker] + 1):
                    if tours.figures[worker, later, KG] > graph.workers[worker, CAPACITY_KG] + SLACK_KG:
                        break
                    found_j, before, behind = best_at(graph, tours, worker, later, delivery, best_j - more_j)
                    if more_j + found_j < best_j:
                        best_j, best_worker, best_position = more_j + found_j, worker, position
                        best_first, best_last = first, last
                        best_later, later_first, later_last = later, before, behind
                tours.order[worker, :length] = saved[:length]
                tours.length[worker] = length
                refresh(graph, horizon_s, tours, worker)
        if best_worker < 0:
            continue
        is_changed[best_worker] = True
        insert(graph, horizon_s, tours, best_worker, best_position, best_first, visit, best_last)
        absent[visit] = False
        if delivery >= 0:
            insert(graph, horizon_s, tours, best_worker, best_later, later_first, delivery, later_last)
            absent[delivery] = False


@njit(cache=True, nogil=True)
def search(
    graph: ChargingGraph,
    horizon_s: float,
    inserted: Inserted,
    tours: ChargingTours,
    best: ChargingTours,
    neighbours: NDArray[np.int32],
    absent: NDArray[np.bool_],
    counts: Floats,
    best_j: float,
    temperature_j: float,
    steps: int,
    rng: np.random.Generator,
) -> float:
    """Take some steps from `tours`, and copy the best routes to `best`.

    Args:
        graph: visits, chargers and workers.
        horizon_s: latest arrival at the ends.
        inserted: of the visits.
        tours: present routes; changed in place.
        best: best routes so far; changed in place, without figures.
        neighbours: (V, V) visits in the order of their distance, for each visit.
        absent: (V,) visits that are not on the present routes; changed in place.
        counts: (V,) how often each visit remained absent; changed in place.
        best_j: value of the best routes: joules plus prizes that are not collected.
        temperature_j: of the annealing.
        steps: number of steps.
        rng: of the random choices.

    Returns: `best_j` of the new best routes.

    """
    workers, most = tours.order.shape
    space, found = np.empty(most, np.int32), np.empty(most, np.int32)
    old_order, old_length = tours.order.copy(), tours.length.copy()
    old_absent = absent.copy()
    is_changed = np.zeros(workers, np.bool_)
    now_j = tours.spent_j.sum() + inserted.prize_j[absent].sum()
    for _ in range(steps):
        is_changed[:] = False
        ruin(graph, horizon_s, inserted.pair, tours, neighbours, absent, is_changed, rng, space, found)
        recreate(graph, horizon_s, inserted, tours, absent, is_changed, rng, space)
        for worker in range(workers):
            if is_changed[worker]:
                recharge(graph, horizon_s, tours, worker, space, found)
        new_j = tours.spent_j.sum() + inserted.prize_j[absent].sum()
        is_kept = new_j < now_j - temperature_j * math.log(1.0 - rng.random())
        if not is_kept and old_absent.any():
            is_kept = counts[absent].sum() < counts[old_absent].sum()
        counts[absent] += 1.0
        if is_kept:
            now_j = new_j
            old_absent[:] = absent
        else:
            absent[:] = old_absent
        for worker in range(workers):
            if not is_changed[worker]:
                continue
            if is_kept:
                old_length[worker] = tours.length[worker]
                old_order[worker] = tours.order[worker]
            else:
                tours.length[worker] = old_length[worker]
                tours.order[worker] = old_order[worker]
                refresh(graph, horizon_s, tours, worker)
        if now_j < best_j - SLACK_J:
            best_j = now_j
            best.order[:] = tours.order
            best.length[:] = tours.length
    return float(best_j)


STEPS = 20
"""Steps that count as one iteration."""
FIRST_PATHS, LAST_PATHS = 1.0, 0.01
"""First and last temperature, in median paths."""
REQUIRED_J = 1e12


class RuinRecreate:
    """Searches of one problem.

    Args:
        team: of the problem.
        visits: likewise, possibly with narrower windows (see `coupling.py`).
        required: (V,) visits that must be made.

    """

    def __init__(self, team: TeamArrays, visits: VisitArrays, required: NDArray[np.bool_]) -> None:
        count, workers = len(visits.job), len(team.start)
        nodes = np.stack(
            [visits.earliest_s, visits.latest_s, visits.service_s, visits.service_j, visits.load_kg], axis=1
        )
        self._horizon_s = team.horizon_s
        self._graph = charging_graph(team, visits.place, visits.exit_place, nodes)
        legs_j = self._graph.leg_j[0]
        between_j = np.minimum(legs_j[:count, :count], legs_j[:count, :count].T)
        self._neighbours = np.argsort(between_j, axis=1, kind="stable").astype(np.int32)
        self._path_j = median_path_j(between_j)
        states = [
            b"".join(
                each.tobytes()
                for each in (
                    self._graph.workers[worker],
                    team.start[worker],
                    team.end_j[worker],
                    team.charges[worker],
                    visits.allowed[worker],
                )
            )
            for worker in range(workers)
        ]
        self._inserted = Inserted(
            np.maximum(visits.delivery, visits.pickup),
            visits.pickup >= 0,
            np.where(required, REQUIRED_J, visits.prize_j),
            visits.allowed,
            np.array([states.index(state) for state in states], np.int64),
            legs_j[count + len(team.charger) :, :count].min(axis=0, initial=math.inf),
        )

    def run(
        self, orders: Sequence[Sequence[int]], effort: Effort, seed: int, *, share: float, end_left_s: float = 0.0
    ) -> list[list[int]]:
        """Return the visits of each worker in order.

        Args:
            orders: visits to begin with.
            effort: stops the search, and is spent by it.
            seed: of the search.
            share: share of the effort to spend.
            end_left_s: stop when no more than this remains of the deadline.

        """
        graph, workers, count = self._graph, len(self._graph.workers), len(self._neighbours)
        tours, best = empty_tours(workers, count), empty_tours(workers, count)
        absent = np.ones(count, np.bool_)
        for worker, order in enumerate(orders):
            rows = np.array(order, np.int32)
            if len(rows):
                size = place_charges(graph, self._horizon_s, worker, rows, len(rows), tours.order[worker])
                tours.length[worker] = max(0, size)
                absent[rows] = size < 0
            refresh(graph, self._horizon_s, tours, worker)
        best.order[:], best.length[:] = tours.order, tours.length
        best_j = float(tours.spent_j.sum() + self._inserted.prize_j[absent].sum())
        counts = np.ones(count)
        rng = np.random.default_rng(seed)
        first_s, first, longest_s = effort.left_s, effort.left_iterations, 0.0
        to_spend_s, to_spend = share * first_s - end_left_s, share * first
        while effort.left_iterations > 0:
            left_s = effort.left_s
            done = (first_s - left_s) / to_spend_s if math.isfinite(first_s) and to_spend_s > 0 else 0.0
            done = max(done, (first - effort.left_iterations) / to_spend if math.isfinite(first) else 0.0)
            if done >= 1 or left_s <= end_left_s + 1.5 * longest_s:
                break
            temperature_j = self._path_j * FIRST_PATHS * (LAST_PATHS / FIRST_PATHS) ** done
            best_j = search(
                graph,
                self._horizon_s,
                self._inserted,
                tours,
                best,
                self._neighbours,
                absent,
                counts,
                best_j,
                temperature_j,
                STEPS,
                rng,
            )
            effort.spend()
            if math.isfinite(left_s):
                longest_s = max(longest_s, left_s - effort.left_s)
        return [
            [int(node) for node in best.order[worker, : best.length[worker]] if node < count]
            for worker in range(workers)
        ]


def median_path_j(legs_j: Floats) -> float:
    """Median of the finite paths; 1 if there are none."""
    finite = legs_j[np.isfinite(legs_j) & (legs_j > 0)]
    return float(np.median(finite)) if finite.size else 1.0
