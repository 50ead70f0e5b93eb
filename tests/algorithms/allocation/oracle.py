"""The exact optimum by CP-SAT, written down without anything of what the allocators are made from.

A circuit for each robot over its start (node 0, which also stands for its end) and the jobs. A job that a robot does
not do has a loop of its own. A robot without jobs has a loop at node 0 *and* all jobs looped: with an optional loop at
node 0 alone, circuits that do not touch the robot's start would be allowed.
"""

import math

import numpy as np
from ortools.sat.python import cp_model

from robrain.algorithms.allocation.plan import Plan, make_plan
from robrain.algorithms.allocation.problem import Objective, Problem

SCALE = 1000
"""Units of a joule and of a second."""


def exact_plan(problem: Problem, objective: Objective = Objective.ENERGY, limit_s: float = 60.0) -> Plan | None:
    """The best plan that there is, up to rounding; None if that is not proved in time.

    Energy, makespan (prizes first) and lifetime (prizes first); windows, needs, budgets, precedence, k at once, pairs
    and loads (of jobs for one robot that do not follow one for several). Waiting must be free and nothing pinned.
    """
    assert all(worker.wait_w == 0 for worker in problem.workers)
    assert not any(job.pinned_to for job in problem.jobs)
    model = cp_model.CpModel()
    count = len(problem.jobs)
    horizon = _horizon(problem)
    deliveries = [
        (problem.job_index[job.same_worker_as], i) for i, job in enumerate(problem.jobs) if job.same_worker_as
    ]
    done = [model.new_bool_var(f"done {job.id}") for job in problem.jobs]
    start = [model.new_int_var(0, horizon, f"start {job.id}") for job in problem.jobs]
    most_kg = max((worker.capacity_kg for worker in problem.workers), default=0.0)
    carried = [model.new_int_var(0, _units(min(most_kg, 1e6)), f"load after {job.id}") for job in problem.jobs]
    does: list[list[cp_model.IntVar]] = []
    routes, spents, ends = [], [], []
    for worker in problem.workers:
        energy, time = problem.energy_j[worker.profile], problem.time_s[worker.profile]
        mine = [model.new_bool_var(f"{worker.name} {job.id}") for job in problem.jobs]
        idle = model.new_bool_var(f"{worker.name} idle")
        end = model.new_int_var(0, horizon, f"{worker.name} end")
        arcs: list[tuple[int, int, cp_model.LiteralT]] = [(0, 0, idle)]
        terms: list[cp_model.LinearExprT] = []
        ways: dict[tuple[int, int], cp_model.IntVar] = {}
        model.add(end == 0).only_enforce_if(idle)
        for index, job in enumerate(problem.jobs):
            arcs.append((index + 1, index + 1, ~mine[index]))
            model.add_implication(idle, ~mine[index])
            if not job.admits(worker):
                model.add(mine[index] == 0)
            first = model.new_bool_var("")
            arcs.append((0, index + 1, first))
            load = _units(job.load_kg)
            if job.robots == 1:
                model.add(carried[index] == _units(worker.load_kg) + load).only_enforce_if(first)
                model.add(carried[index] <= _units(min(worker.capacity_kg, 1e6))).only_enforce_if(mine[index])
            ways[0, index + 1] = first
            terms.append(_units(energy[worker.start, job.place] + job.service_j) * first)
            model.add(start[index] >= _units(worker.ready_s + time[worker.start, job.place])).only_enforce_if(first)
            last = model.new_bool_var("")
            arcs.append((index + 1, 0, last))
            charger = worker.ends[int(np.argmin(energy[job.exit_place, list(worker.ends)]))]
            terms.append(_units(energy[job.exit_place, charger]) * last)
            model.add(end == start[index] + _units(job.service_s + time[job.exit_place, charger])).only_enforce_if(last)
            for other_index, other in enumerate(problem.jobs):
                if other_index == index:
                    continue
                way = model.new_bool_var("")
                arcs.append((index + 1, other_index + 1, way))
                ways[index + 1, other_index + 1] = way
                terms.append(_units(energy[job.exit_place, other.place] + other.service_j) * way)
                gap = _units(job.service_s + time[job.exit_place, other.place])
                model.add(start[other_index] >= start[index] + gap).only_enforce_if(way)
                if job.robots == other.robots == 1:
                    more = _units(other.load_kg)
                    model.add(carried[other_index] == carried[index] + more).only_enforce_if(way)
        for pickup, delivery in deliveries:
            model.add(mine[pickup] == mine[delivery])
        model.add_circuit(arcs)
        spent = cp_model.LinearExpr.sum(terms)
        model.add(spent <= _units(worker.usable_j))
        does.append(mine)
        routes.append(ways)
        spents.append(spent)
        ends.append(end)
    for index, job in enumerate(problem.jobs):
        model.add(sum(mine[index] for mine in does) == job.robots * done[index])
        model.add(start[index] >= _units(job.earliest_s)).only_enforce_if(done[index])
        if math.isfinite(job.latest_s):
            model.add(start[index] + _units(job.service_s) <= _units(job.latest_s)).only_enforce_if(done[index])
        for name in problem.predecessors(job):
            earlier = problem.job_index[name]
            gap = _units(problem.jobs[earlier].service_s)
            model.add_implication(done[index], done[earlier])
            model.add(start[index] >= start[earlier] + gap).only_enforce_if(done[index])
    lost = cp_model.LinearExpr.sum([_units(job.prize_j) * (1 - done[index]) for index, job in enumerate(problem.jobs)])
    if objective is Objective.ENERGY:
        model.minimize(cp_model.LinearExpr.sum([*spents, lost]))
    else:
        most = horizon if objective is Objective.MAKESPAN else _units(max(w.usable_j for w in problem.workers))
        bound = model.new_int_var(0, most, "bound")
        for worker, spent, end in zip(problem.workers, spents, ends, strict=True):
            model.add(end <= bound if objective is Objective.MAKESPAN else bound <= _units(worker.usable_j) - spent)
        missing = sum(1 - one for one in done)
        # Prizes first; whoever asks for these objectives gives equal prizes.
        model.minimize(missing * 2 * most + (bound if objective is Objective.MAKESPAN else -bound))
    solver = cp_model.CpSolver()
    solver.parameters.max_time_in_seconds = limit_s
    solver.parameters.num_workers = 2
    solver.parameters.random_seed = 1
    if solver.solve(model) != cp_model.OPTIMAL:
        return None
    orders = [_order(solver, ways, count) for ways in routes]
    names = [[problem.jobs[index].id for index in order] for order in orders]
    return make_plan(problem, names, objective)


def _order(solver: cp_model.CpSolver, ways: dict[tuple[int, int], cp_model.IntVar], count: int) -> list[int]:
    following = {source: target for (source, target), way in ways.items() if solver.boolean_value(way)}
    order: list[int] = []
    node = 0
    while node in following and len(order) <= count:
        node = following[node]
        order.append(node - 1)
    return order


def _units(value: float) -> int:
    return round(SCALE * float(value))


def _horizon(problem: Problem) -> int:
    if math.isfinite(problem.horizon_s):
        return _units(problem.horizon_s)
    longest_s = float(problem.time_s.max())
    ready_s = max(worker.ready_s for worker in problem.workers)
    earliest_s = max((job.earliest_s for job in problem.jobs), default=0.0)
    return _units(ready_s + earliest_s + sum(job.service_s + 2 * longest_s for job in problem.jobs) + longest_s)
