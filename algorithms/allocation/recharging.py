"""Recharges within routes: the charges that an order of visits needs, at the least energy.

A worker with `chargers` may charge between two visits, always to `full_j`. The charges of a given order are a
shortest path with resources. A label has the joules spent, the time and the joules left. It is extended to the next
visit directly, by one charger, or by two in a row where the second is too far away. Labels that are better in none of
the three are dropped.
Source: Montoya, Guéret, Mendoza, Villegas: The Electric Vehicle Routing Problem with Nonlinear Charging Function,
Transportation Research B 103, 2017, section 4.4 (fixed route vehicle charging problem).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.allocation.insertion import SLACK_J, SLACK_S
from robrain.algorithms.allocation.problem import Floats, Indices, Problem, TeamArrays, team_arrays

NEAREST = 4
"""Chargers tried between two nodes: those of the least detour."""
LABELS = 24
"""Labels kept for each visit."""

EARLIEST_S, LATEST_S, SERVICE_S, SERVICE_J, LOAD_KG = range(5)
"""Columns of `ChargingGraph.nodes`; the latest time is that of the start."""
READY_S, USABLE_J, FULL_J, CHARGE_W, CAPACITY_KG, START_KG, PROFILE = range(7)
"""Columns of `ChargingGraph.workers`."""


class ChargingGraph(NamedTuple):
    """N nodes: V visits, then C chargers, then one node for each of W workers, which is its start and its end."""

    leg_j: Floats
    """(profiles, N, N) joules from the exit of a node to the place of another one."""
    leg_s: Floats
    """(profiles, N, N) likewise, seconds."""
    nodes: Floats
    """(V + C, 5)"""
    workers: Floats
    """(W, 7)"""
    charges: NDArray[np.bool_]
    """(W, C) whether the worker may charge there."""
    near: NDArray[np.int16]
    """(profiles, N, N, `NEAREST`) chargers between two nodes, of least detour first; -1 at the end of shorter lists."""
    reach_j: Floats
    """(W, N) joules from each node to the nearest charger or end of the worker."""


def charging_graph(team: TeamArrays, place: Indices, exit_place: Indices, nodes: Floats) -> ChargingGraph:
    """Make the graph of visits with these places, (V,), and figures, (V, 5)."""
    visits, count, workers = len(place), len(place) + len(team.charger), len(team.start)
    rows = np.concatenate([exit_place, team.charger, team.start]).astype(np.int64)
    columns = np.concatenate([place, team.charger]).astype(np.int64)
    leg_j, leg_s = (np.full((len(team.energy_j), len(rows), len(rows)), math.inf) for _ in range(2))
    for profile in range(len(team.energy_j)):
        leg_j[profile, :, :count] = team.energy_j[profile][np.ix_(rows, columns)]
        leg_s[profile, :, :count] = team.time_s[profile][np.ix_(rows, columns)]
    for worker, profile in enumerate(team.profile):
        leg_j[profile, :, count + worker] = team.end_j[worker, rows]
        leg_s[profile, :, count + worker] = team.end_s[worker, rows]
    near = np.full((*leg_j.shape, NEAREST), -1, np.int16)
    reach_j = np.zeros((workers, len(rows)))
    chargers = slice(visits, count)
    for profile, legs_j in enumerate(leg_j):
        _find_nearest(legs_j, visits, count, near[profile])
    for worker, profile in enumerate(team.profile):
        to_charger = np.where(team.charges[worker], leg_j[profile][:, chargers], math.inf).min(axis=1, initial=math.inf)
        reach_j[worker] = np.minimum(leg_j[profile][:, count + worker], to_charger)
    free = np.tile([-math.inf, math.inf, 0.0, 0.0, 0.0], (len(team.charger), 1))
    figures = (team.ready_s, team.usable_j, team.full_j, team.charge_w, team.capacity_kg, team.load_kg, team.profile)
    table = np.stack(figures, axis=1).astype(np.float64)
    return ChargingGraph(leg_j, leg_s, np.concatenate([nodes, free]), table, team.charges, near, reach_j)


@njit(cache=True, nogil=True)
def _find_nearest(legs_j: Floats, first: int, last: int, near: NDArray[np.int16]) -> None:
    """Write the chargers of least detour between all nodes to `near`; nodes `first` to `last` are the chargers."""
    detours_j = np.empty(near.shape[2])
    for row in range(len(legs_j)):
        for column in range(len(legs_j)):
            found = near[row, column]
            size = 0
            for charger in range(first, last):
                detour_j = legs_j[row, charger] + legs_j[charger, column]
                place = size
                while place > 0 and detour_j < detours_j[place - 1]:
                    place -= 1
                if place == len(found) or not detour_j < math.inf:
                    continue
                size = min(size + 1, len(found))
                for later in range(size - 1, place, -1):
                    found[later], detours_j[later] = found[later - 1], detours_j[later - 1]
                found[place], detours_j[place] = charger - first, detour_j


def charges_of(problem: Problem, orders: Sequence[Sequence[str]]) -> list[list[tuple[int, ...]]]:
    """The places where each worker charges before each of its jobs, and before its end.

    There are none if no charges make an order feasible.
    """
    chargers: list[list[tuple[int, ...]]] = [[()] * (len(order) + 1) for order in orders]
    team = team_arrays(problem)
    jobs = [problem.jobs[problem.job_index[name]] for order in orders for name in order]
    nodes = [(job.earliest_s, job.latest_s - job.service_s, job.service_s, job.service_j, job.load_kg) for job in jobs]
    places, exits = (np.array([getattr(job, name) for job in jobs], np.int64) for name in ("place", "exit_place"))
    graph = charging_graph(team, places, exits, np.array(nodes, np.float64).reshape(len(jobs), 5))
    end = 0
    for worker, order in enumerate(orders):
        rows, end = np.arange(end, end + len(order), dtype=np.int32), end + len(order)
        if order and team.charge_w[worker] > 0:
            found = np.zeros(3 * len(rows) + 2, np.int32)
            size = place_charges(graph, team.horizon_s, worker, rows, len(rows), found)
            step = 0
            for node in found[: max(0, size)]:
                if node < len(jobs):
                    step += 1
                else:
                    chargers[worker][step] += (int(team.charger[node - len(jobs)]),)
    return chargers


@njit(cache=True, nogil=True)
def place_charges(
    graph: ChargingGraph, horizon_s: float, worker: int, order: NDArray[np.int32], length: int, found: NDArray[np.int32]
) -> int:
    """Write an order of visits with its charges of least energy to `found`, as nodes. Waiting costs no energy here.

    Returns: Length of `found`; -1 if no charges make the order feasible.

    """
    figures = graph.workers[worker]
    profile, full_j, charge_w = int(figures[PROFILE]), figures[FULL_J], figures[CHARGE_W]
    leg_j, leg_s, near = graph.leg_j[profile], graph.leg_s[profile], graph.near[profile]
    chargers = graph.charges.shape[1]
    visits = len(graph.nodes) - chargers
    labels = np.empty((length + 2, LABELS, 3))
    parents = np.full((length + 2, LABELS, 3), -1, np.int32)
    kept = np.zeros(length + 2, np.int64)
    labels[0, 0, 0], labels[0, 0, 1], labels[0, 0, 2] = 0.0, figures[READY_S], figures[USABLE_J]
    kept[0] = 1
    for step in range(length + 1):
        node = len(graph.nodes) + worker if step == 0 else order[step - 1]
        target = len(graph.nodes) + worker if step == length else order[step]
        earliest_s, latest_s, service_s, service_j, least_j = -math.inf, horizon_s, 0.0, 0.0, 0.0
        if step < length:
            earliest_s, latest_s = graph.nodes[target, EARLIEST_S], graph.nodes[target, LATEST_S]
            service_s, service_j = graph.nodes[target, SERVICE_S], graph.nodes[target, SERVICE_J]
            least_j = graph.reach_j[worker, target]
        for row in range(kept[step]):
            for choice in range(-1, NEAREST if charge_w > 0.0 else 0):
                stop = -1 if choice < 0 else near[node, target, choice]
                if choice >= 0 and (stop < 0 or not graph.charges[worker, stop]):
                    continue
                # A charger before one that can be reached without it costs more energy and time, and gains nothing.
                is_far = stop >= 0 and labels[step, row, 2] < leg_j[node, visits + stop] - SLACK_J
                for nearest in range(NEAREST if is_far else 1):
                    first = near[node, visits + stop, nearest] if is_far else -1
                    if is_far and (first < 0 or not graph.charges[worker, first]):
                        continue
                    here, label = node, labels[step, row]
                    spent_j, now_s, left_j = label[0], label[1], label[2]
                    for charger in (first, stop):
                        if charger >= 0:
                            at = visits + charger
                            left_j -= leg_j[here, at]
                            if left_j < -SLACK_J:
                                break
                            spent_j += leg_j[here, at]
                            now_s += leg_s[here, at] + (full_j - left_j) / charge_w
                            here, left_j = at, full_j
                    start_s, more_j = max(now_s + leg_s[here, target], earliest_s), leg_j[here, target] + service_j
                    spent_j, end_s = spent_j + more_j, start_s + service_s
                    if left_j < -SLACK_J or start_s > latest_s + SLACK_S or left_j - more_j < least_j - SLACK_J:
                        continue
                    new = _keep(labels[step + 1], parents[step + 1], kept, step + 1, spent_j, end_s, left_j - more_j)
                    if new >= 0:
                        parents[step + 1, new, 0] = row
                        parents[step + 1, new, 1] = first
                        parents[step + 1, new, 2] = stop
        if kept[step + 1] == 0:
            return -1
    row = 0
    for other in range(1, kept[length + 1]):
        if labels[length + 1, other, 0] < labels[length + 1, row, 0]:
            row = other
    size, best = length, row
    for step in range(length + 1, 0, -1):
        size += int(parents[step, row, 1] >= 0) + int(parents[step, row, 2] >= 0)
        row = parents[step, row, 0]
    if size > len(found):
        return -1
    position, row = size, best
    for step in range(length + 1, 0, -1):
        if step <= length:
            position -= 1
            found[position] = order[step - 1]
        for column in (2, 1):
            if parents[step, row, column] >= 0:
                position -= 1
                found[position] = visits + parents[step, row, column]
        row = parents[step, row, 0]
    return size


@njit(cache=True, nogil=True)
def _keep(
    labels: Floats, parents: NDArray[np.int32], kept: Indices, step: int, spent_j: float, end_s: float, left_j: float
) -> int:
    """Add a label unless another is as good in everything; returns its row, -1 if it is not added."""
    count = kept[step]
    for row in range(count):
        if labels[row, 0] <= spent_j and labels[row, 1] <= end_s and labels[row, 2] >= left_j:
            return -1
    row = 0
    while row < count:
        if labels[row, 0] >= spent_j and labels[row, 1] >= end_s and labels[row, 2] <= left_j:
            count -= 1
            labels[row] = labels[count]
            parents[row] = parents[count]
        else:
            row += 1
    row = count
    if count == len(labels):
        row = int(np.argmax(labels[:, 0]))
        count -= 1
        if labels[row, 0] <= spent_j:
            kept[step] = count + 1
            return -1
    kept[step] = count + 1
    labels[row, 0], labels[row, 1], labels[row, 2] = spent_j, end_s, left_j
    return row
