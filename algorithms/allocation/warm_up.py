"""Compiles the allocators' kernels before a run, so that the first plan is not delayed."""

import msgspec
import numpy as np

from robrain.algorithms.allocation.auction import AuctionAllocator, GreedyAllocator
from robrain.algorithms.allocation.insertion import empty_routes
from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.problem import Job, Objective, Problem, Worker, make_arrays
from robrain.algorithms.allocation.reinsertion import reinsert
from robrain.algorithms.allocation.vrp_model import fill_matrix


def warm_up(*, with_charges: bool = False) -> None:
    """Call every kernel once; on request those of routes with charges, too.

    The first call on a machine compiles the kernels and stores the machine code beside the sources (some seconds).
    Later processes load it (tenths of a second).
    """
    legs = np.array([[[0.0, 2.0], [2.0, 0.0]]])
    jobs = (
        Job(id="a", place=1, prize_j=9.0),
        Job(id="b", place=1, prize_j=9.0, after=("a",)),
        Job(id="c", place=1, prize_j=9.0),
        Job(id="d", place=1, prize_j=0.0, latest_s=0.0),
    )
    problem = Problem(
        jobs=jobs, workers=(Worker(name="r", start=0, ends=(0,), usable_j=9.0),), energy_j=legs, time_s=legs
    )
    for objective in Objective:
        AuctionAllocator(objective).plan(problem)
        GreedyAllocator(objective).plan(problem)
    arrays = make_arrays(problem)
    routes, is_open = empty_routes(arrays.team, arrays.visits), np.ones(len(jobs), np.bool_)
    reinsert(arrays.team, arrays.visits, arrays.visits.prize_j, routes, is_open, 1, np.random.default_rng(0))
    if with_charges:
        worker = Worker(name="r", start=0, ends=(0,), usable_j=5.0, chargers=(0,), full_j=5.0, charge_w=1.0)
        charging = msgspec.structs.replace(problem, workers=(worker,))
        OptimalAllocator(Objective.ENERGY, lambda: 0.0).plan(charging, iterations=2)
    fill_matrix(
        legs[0], np.array([1, 0]), np.array([1]), np.ones(1, np.bool_), np.zeros(1), np.zeros((2, 1)), 1.0, 0, True
    )
