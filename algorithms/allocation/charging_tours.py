"""Routes with charges between visits: their figures, insertions, and the places of their charges.

Charges are full, so routes fall into segments between charges. One more visit in a segment costs energy, which the
charge at its end must replace, and so delays all that follows. Figures of segments make this check independent of the
length of the route.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.allocation.insertion import SLACK_J, SLACK_S
from robrain.algorithms.allocation.problem import Floats, Indices
from robrain.algorithms.allocation.recharging import (
    CHARGE_W,
    EARLIEST_S,
    FULL_J,
    LATEST_S,
    LOAD_KG,
    PROFILE,
    READY_S,
    SERVICE_J,
    SERVICE_S,
    START_KG,
    USABLE_J,
    ChargingGraph,
    place_charges,
)

NEAR_TRIED = 3
"""Chargers tried before and after an inserted visit."""

LEAVE_S, LEFT_J, KG, LEAST_KG, MOST_KG, NEED_J, NEED_S, WAIT_S, LATE_S, STOP_LATE_S, STOP_LEFT_J, IS_LAST = range(12)
"""Columns of `ChargingTours.figures`. A segment ends at the next charger, or at the end of the route.

Departure from the node before the position, joules left and load then; the least and the greatest load from then on.
From the arrival at the position to the arrival at the segment's end: joules, and seconds without waiting. The earliest
arrival at the segment's end that the windows allow. The latest arrival at the position that meets the windows of the
segment. The latest arrival at the segment's end that meets all later windows with the present charges; joules left
then. Whether no charger follows.
"""


class ChargingTours(NamedTuple):
    """W routes of up to M nodes."""

    order: NDArray[np.int32]
    """(W, M) nodes of a `ChargingGraph`."""
    length: Indices
    """(W,)"""
    figures: Floats
    """(W, M + 1, 12) for each position, the last of which is the end."""
    spent_j: Floats
    """(W,) without waiting; 0 for an empty route."""


def empty_tours(workers: int, visits: int) -> ChargingTours:
    """Routes without visits; `refresh` fills the figures."""
    most = 2 * visits + 6
    lengths = np.zeros(workers, np.int64)
    return ChargingTours(
        np.zeros((workers, most), np.int32), lengths, np.zeros((workers, most + 1, 12)), np.zeros(workers)
    )


@njit(cache=True, nogil=True)
def refresh(graph: ChargingGraph, horizon_s: float, tours: ChargingTours, worker: int) -> None:
    """Recompute a route's figures."""
    own = graph.workers[worker]
    profile, full_j, charge_w = int(own[PROFILE]), own[FULL_J], own[CHARGE_W]
    leg_j, leg_s = graph.leg_j[profile], graph.leg_s[profile]
    visits, home = len(graph.nodes) - graph.charges.shape[1], len(graph.nodes) + worker
    order, length, figures = tours.order[worker], tours.length[worker], tours.figures[worker]
    node, now_s, left_j, load_kg, spent_j = home, own[READY_S], own[USABLE_J], own[START_KG], 0.0
    figures[0, LEAVE_S], figures[0, LEFT_J], figures[0, KG] = now_s, left_j, load_kg
    for position in range(length):
        after = order[position]
        now_s += leg_s[node, after]
        left_j -= leg_j[node, after]
        spent_j += leg_j[node, after]
        node = after
        if node < visits:
            now_s = max(now_s, graph.nodes[node, EARLIEST_S]) + graph.nodes[node, SERVICE_S]
            left_j -= graph.nodes[node, SERVICE_J]
            spent_j += graph.nodes[node, SERVICE_J]
            load_kg += graph.nodes[node, LOAD_KG]
        else:
            figures[position, STOP_LEFT_J] = left_j
            now_s += (full_j - left_j) / charge_w
            left_j = full_j
        figures[position + 1, LEAVE_S], figures[position + 1, LEFT_J] = now_s, left_j
        figures[position + 1, KG] = load_kg
    if length > 0:
        left_j -= leg_j[node, home]
        spent_j += leg_j[node, home]
    tours.spent_j[worker] = spent_j
    need_j, need_s, wait_s, late_s, stop_late_s, is_last = 0.0, 0.0, -math.inf, math.inf, horizon_s, 1.0
    least_kg = most_kg = load_kg
    after = home
    for position in range(length, -1, -1):
        if position < length:
            node = order[position]
            if node < visits:
                service_s = graph.nodes[node, SERVICE_S]
                need_j += graph.nodes[node, SERVICE_J] + leg_j[node, after]
                need_s += service_s + leg_s[node, after]
                wait_s = max(wait_s, graph.nodes[node, EARLIEST_S] + need_s)
                late_s = min(graph.nodes[node, LATEST_S], late_s - service_s - leg_s[node, after])
            else:
                left_j = figures[position, STOP_LEFT_J]
                stop_late_s = min(late_s, stop_late_s - need_s) - leg_s[node, after] - (full_j - left_j) / charge_w
                need_j, need_s, wait_s, late_s, is_last = 0.0, 0.0, -math.inf, math.inf, 0.0
            after = node
        figures[position, NEED_J], figures[position, NEED_S] = need_j, need_s
        figures[position, WAIT_S], figures[position, LATE_S] = wait_s, late_s
        figures[position, STOP_LATE_S], figures[position, STOP_LEFT_J] = stop_late_s, left_j
        figures[position, IS_LAST] = is_last
        least_kg, most_kg = min(least_kg, figures[position, KG]), max(most_kg, figures[position, KG])
        figures[position, LEAST_KG], figures[position, MOST_KG] = least_kg, most_kg


FITS, LATE, LACKS_CHARGE = range(3)
"""Results of `fit`. `LATE`: the visit or one in its segment would be late, and charges would only add to it.
`LACKS_CHARGE`: the energy does not suffice, or the next charge would take too long."""


@njit(cache=True, nogil=True)
def fit(
    graph: ChargingGraph, tours: ChargingTours, worker: int, position: int, first: int, visit: int, last: int
) -> int:
    """Check a route with a visit at a position, and with chargers before and after the visit (-1 for none)."""
    figures = tours.figures[worker, position]
    profile = int(graph.workers[worker, PROFILE])
    leg_j, leg_s = graph.leg_j[profile], graph.leg_s[profile]
    full_j, charge_w = graph.workers[worker, FULL_J], graph.workers[worker, CHARGE_W]
    visits, home = len(graph.nodes) - graph.charges.shape[1], len(graph.nodes) + worker
    node = home if position == 0 else tours.order[worker, position - 1]
    after = home if position == tours.length[worker] else tours.order[worker, position]
    now_s, left_j, is_enough = figures[LEAVE_S], figures[LEFT_J], True
    for stop, target in ((first, visit), (last, after)):
        if stop >= 0:
            at = visits + stop
            left_j -= leg_j[node, at]
            if left_j < -SLACK_J:
                return LACKS_CHARGE
            now_s += leg_s[node, at] + (full_j - left_j) / charge_w
            node, left_j = at, full_j
        now_s += leg_s[node, target]
        left_j -= leg_j[node, target]
        if now_s > (graph.nodes[visit, LATEST_S] if target == visit else figures[LATE_S]) + SLACK_S:
            return LATE
        if target == visit:
            is_enough = left_j >= -SLACK_J
            now_s = max(now_s, graph.nodes[visit, EARLIEST_S]) + graph.nodes[visit, SERVICE_S]
            left_j -= graph.nodes[visit, SERVICE_J]
            node = visit
    left_j -= figures[NEED_J]
    if not is_enough or left_j < -SLACK_J:
        return LACKS_CHARGE
    stop_s = max(now_s + figures[NEED_S], figures[WAIT_S])
    if figures[IS_LAST] == 0.0:
        stop_s += (figures[STOP_LEFT_J] - left_j) / charge_w
    return FITS if stop_s <= figures[STOP_LATE_S] + SLACK_S else LACKS_CHARGE


@njit(cache=True, nogil=True)
def best_at(
    graph: ChargingGraph, tours: ChargingTours, worker: int, position: int, visit: int, best_j: float
) -> tuple[float, int, int]:
    """Least additional joules of a visit at a position, and the chargers before and after it (-1 for none).

    The joules are infinite if nothing feasible costs less than `best_j`.
    """
    own, length = graph.workers[worker], tours.length[worker]
    profile = int(own[PROFILE])
    leg_j, near = graph.leg_j[profile], graph.near[profile]
    visits, home = len(graph.nodes) - graph.charges.shape[1], len(graph.nodes) + worker
    node = home if position == 0 else tours.order[worker, position - 1]
    after = home if position == length else tours.order[worker, position]
    base_j = leg_j[node, visit] + graph.nodes[visit, SERVICE_J] + leg_j[visit, after]
    if length > 0:
        base_j -= leg_j[node, after]
    if not base_j < best_j:
        return math.inf, -1, -1
    found_j, best_first, best_last = math.inf, -1, -1
    plain = fit(graph, tours, worker, position, -1, visit, -1)
    if plain == FITS:
        return base_j, -1, -1
    if plain == LATE or own[CHARGE_W] <= 0.0:
        return found_j, best_first, best_last
    for before in range(-1, NEAR_TRIED):
        first, first_j = -1, base_j
        if before >= 0:
            first = near[node, visit, before]
            if first < 0:
                break
            if not graph.charges[worker, first]:
                continue
            first_j += leg_j[node, visits + first] + leg_j[visits + first, visit] - leg_j[node, visit]
            if not first_j < best_j:
                break  # later chargers are farther
        for behind in range(-1 if before >= 0 else 0, NEAR_TRIED):
            last, more_j = -1, first_j
            if behind >= 0:
                last = near[visit, after, behind]
                if last < 0:
                    break
                if not graph.charges[worker, last]:
                    continue
                more_j += leg_j[visit, visits + last] + leg_j[visits + last, after] - leg_j[visit, after]
            if not more_j < best_j:
                break
            if fit(graph, tours, worker, position, first, visit, last) == FITS:
                best_j = found_j = more_j
                best_first, best_last = first, last
                break  # later chargers are farther
    return found_j, best_first, best_last


@njit(cache=True, nogil=True)
def insert(
    graph: ChargingGraph,
    horizon_s: float,
    tours: ChargingTours,
    worker: int,
    position: int,
    first: int,
    visit: int,
    last: int,
) -> int:
    """Insert a visit with its chargers; returns its position."""
    visits = len(graph.nodes) - graph.charges.shape[1]
    more = 1 + int(first >= 0) + int(last >= 0)
    order = tours.order[worker]
    for index in range(tours.length[worker] - 1, position - 1, -1):
        order[index + more] = order[index]
    at = position
    if first >= 0:
        order[at] = visits + first
        at += 1
    order[at] = visit
    if last >= 0:
        order[at + 1] = visits + last
    tours.length[worker] += more
    refresh(graph, horizon_s, tours, worker)
    return at


@njit(cache=True, nogil=True)
def recharge(
    graph: ChargingGraph,
    horizon_s: float,
    tours: ChargingTours,
    worker: int,
    order: NDArray[np.int32],
    found: NDArray[np.int32],
) -> None:
    """Place the charges of a route again, if it has some and this saves energy. `order` and `found` are (M,) space."""
    visits, length, size = len(graph.nodes) - graph.charges.shape[1], tours.length[worker], 0
    for position in range(length):
        if tours.order[worker, position] < visits:
            order[size] = tours.order[worker, position]
            size += 1
    if size == length:
        return
    if size > 0:
        size = place_charges(graph, horizon_s, worker, order, size, found)
    if size < 0:
        return
    before_j = tours.spent_j[worker]
    order[:length] = tours.order[worker, :length]
    tours.order[worker, :size] = found[:size]
    tours.length[worker] = size
    refresh(graph, horizon_s, tours, worker)
    if tours.spent_j[worker] > before_j:
        tours.order[worker, :length] = order[:length]
        tours.length[worker] = length
        refresh(graph, horizon_s, tours, worker)
