"""The model for PyVRP: what a robot may not do is forbidden by missing ways, or by loads where those are too many."""

import msgspec
import numpy as np
import pytest

from robrain.algorithms.allocation import vrp_model
from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.problem import Objective, Problem, make_arrays
from robrain.algorithms.allocation.vrp_model import VrpModel, fill_matrix
from robrain.algorithms.allocation.warm_up import warm_up
from tests.algorithms.allocation.instances import team_problem
from tests.algorithms.allocation.test_validate import MORE, PAIR, job, line, worker

CAMERA, ARM = frozenset({"camera"}), frozenset({"arm"})


def model_of(problem: Problem) -> VrpModel:
    arrays = make_arrays(problem)
    return VrpModel(problem, arrays, arrays.visits, np.zeros(len(arrays.visits.job), np.bool_), Objective.ENERGY)


def is_feasible(model: VrpModel, *orders: list[int]) -> bool:
    return bool(model.solution(model.data, orders).is_feasible())


JOBS = [job("see", 1, needs=CAMERA), job("lift", 2, needs=ARM), job("both", 3, needs=CAMERA | ARM), job("go", 4)]
ROBOTS = [worker("r1", offers=CAMERA), worker("r2", offers=CAMERA | ARM), worker("r3")]
LIMITED = [job("not r1", 1, forbidden_workers=frozenset({"r1"})), job("any", 2)]


@pytest.mark.parametrize("most_cells", [0, 1e7])
@pytest.mark.parametrize(
    ("jobs", "robots", "able"),
    [
        (JOBS, ROBOTS, [{0, 3}, {0, 1, 2, 3}, {3}]),
        (LIMITED, [worker("r1"), worker("r2"), worker("r3")], [{1}, {0, 1}, {0, 1}]),
    ],
    ids=["what it lacks", "what it is not to be given"],
)
def test_a_robot_is_given_only_what_it_can_and_may_do(monkeypatch, most_cells, jobs, robots, able):
    monkeypatch.setattr(vrp_model, "MOST_CELLS", most_cells)
    model = model_of(line(jobs, robots))
    for robot, visits in enumerate(able):
        for visit in range(len(jobs)):
            orders: list[list[int]] = [[], [], []]
            orders[robot] = [visit]
            assert is_feasible(model, *orders) is (visit in visits), (robot, visit)


def test_a_robot_that_cannot_even_begin_is_no_vehicle_and_orders_are_of_all_robots():
    problem = line([job("a", 1), job("b", 2)], [worker("out", usable_j=-1.0), worker("r2")])
    model = model_of(problem)
    assert model.data.num_vehicles == 1
    solution = model.solution(model.data, [[], [1, 0]])
    assert solution.is_feasible()
    assert model.orders(solution) == [[], [1, 0]]


@pytest.mark.parametrize(("usable_j", "fits"), [(6.0, True), (5.99, False)])
def test_a_robot_goes_as_far_as_its_energy_takes_it_there_and_back(usable_j, fits):
    assert is_feasible(model_of(line([job("a", 3)], [worker("r1", usable_j=usable_j)])), [0]) is fits


@pytest.mark.parametrize(("usable_j", "fits"), [(6.0, True), (5.99, False)])
def test_path_after_a_job_begins_where_it_ends(usable_j, fits):
    jobs = [job("moved", 1, end_place=5), job("next", 5)]
    assert is_feasible(model_of(line(jobs, [worker("r1", usable_j=usable_j)])), [0, 1]) is fits


@pytest.mark.parametrize(
    ("orders", "capacity_kg", "fits"),
    [
        ([[0, 1, 2, 3], []], 2.0, True),
        ([[0, 2, 1, 3], []], 2.0, False),
        ([[0, 2, 1, 3], []], 4.0, True),
        ([[0, 1], [2, 3]], 2.0, True),
        ([[0, 1], [4]], 2.0, True),
        ([[0, 4, 1], []], 2.4, False),
        ([[4, 0, 1], []], 2.4, False),
    ],
)
def test_loads_of_pairs_and_single_jobs_count_along_the_route(orders, capacity_kg, fits):
    jobs = [*PAIR, *MORE, job("box", 3, load_kg=0.5)]
    robots = [worker("r1", capacity_kg=capacity_kg), worker("r2", capacity_kg=capacity_kg)]
    model = model_of(line(jobs, robots))
    solution = model.solution(model.data, orders)
    assert bool(solution.is_feasible()) is fits
    assert model.orders(solution) == orders


@pytest.mark.parametrize("most_cells", [0, 1e7])
def test_both_halves_of_a_pair_need_what_either_needs(monkeypatch, most_cells):
    monkeypatch.setattr(vrp_model, "MOST_CELLS", most_cells)
    pair = [PAIR[0], msgspec.structs.replace(PAIR[1], needs=ARM)]
    model = model_of(line(pair, [worker("r1"), worker("r2", offers=ARM)]))
    assert not is_feasible(model, [0, 1], [])
    assert is_feasible(model, [], [0, 1])


@pytest.mark.parametrize(
    ("limits", "fits"),
    [({"end_s": 6.0}, True), ({"end_s": 5.9}, False), ({"left_j": 4.0}, True), ({"left_j": 4.1}, False), ({}, True)],
    ids=str,
)
def test_limits_may_be_tighter_without_another_model(limits, fits):
    model = model_of(line([job("a", 3), job("b", 5)], [worker("r1")]))
    assert bool(model.solution(model.limited(**limits), [[0]]).is_feasible()) is fits


@pytest.mark.parametrize("objective", [Objective.MAKESPAN, Objective.LIFETIME])
def test_a_prize_outweighs_every_way_unless_energy_is_the_objective(objective):
    problem = line([job("a", 5)], [worker("r1", usable_j=1000.0)])
    arrays = make_arrays(problem)
    for of, outweighs in ((Objective.ENERGY, False), (objective, True)):
        model = VrpModel(problem, arrays, arrays.visits, np.zeros(1, np.bool_), of)
        (client,) = model.data.clients()
        (vehicle,) = model.data.vehicle_types()
        assert (client.prize >= 2 * vehicle.max_distance) is outweighs
        assert not client.required


def test_all_kernels_of_a_plan_are_compiled_before_the_run():
    """A coordinator whose first plan compiles one is late by a second."""
    warm_up()
    before = set(fill_matrix.signatures)
    OptimalAllocator(Objective.ENERGY, lambda: 0.0).plan(team_problem(3, 6, 1), iterations=2)
    assert set(fill_matrix.signatures) == before


def test_pair_whose_delivery_ends_before_its_pickup_may_begin_is_no_error():
    late = [
        job("get", 1, earliest_s=9.0, load_kg=2.0),
        job("put", 2, latest_s=5.0, load_kg=-2.0, after=("get",), same_worker_as="get"),
    ]
    model_of(line(late, [worker("r1", capacity_kg=3.0)]))
