"""The model for PyVRP: what a robot may not do is forbidden by missing ways, or by loads where those are too many."""

import numpy as np
import pytest

from robrain.algorithms.allocation import vrp_model
from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.problem import Objective, Problem, make_arrays
from robrain.algorithms.allocation.vrp_model import VrpModel, fill_matrix
from robrain.algorithms.allocation.warm_up import warm_up
from tests.algorithms.allocation.instances import team_problem
from tests.algorithms.allocation.test_validate import job, line, worker

CAMERA, ARM = frozenset({"camera"}), frozenset({"arm"})


def model_of(problem: Problem) -> VrpModel:
    arrays = make_arrays(problem)
    return VrpModel(problem, arrays, arrays.visits, np.zeros(len(arrays.visits.job), np.bool_), Objective.ENERGY)


@pytest.fixture
def needy() -> Problem:
    jobs = [job("see", 1, needs=CAMERA), job("lift", 2, needs=ARM), job("both", 3, needs=CAMERA | ARM), job("go", 4)]
    return line(jobs, [worker("r1", offers=CAMERA), worker("r2", offers=CAMERA | ARM), worker("r3")])


def is_feasible(model: VrpModel, *orders: list[int]) -> bool:
    return bool(model.solution(model.data, orders).is_feasible())


def test_where_ways_of_their_own_would_be_too_many_needs_are_loads(needy, monkeypatch):
    monkeypatch.setattr(vrp_model, "MOST_CELLS", 0)
    model = model_of(needy)
    assert model.data.num_profiles == 1
    assert [list(client.delivery) for client in model.data.clients()] == [[0, 1], [1, 0], [1, 1], [0, 0]]
    assert [list(vehicle.capacity) for vehicle in model.data.vehicle_types()] == [[0, 4], [4, 4], [0, 0]]


@pytest.mark.parametrize("most_cells", [0, 1e7])
def test_a_robot_that_lacks_something_cannot_do_what_needs_it(needy, monkeypatch, most_cells):
    monkeypatch.setattr(vrp_model, "MOST_CELLS", most_cells)
    model = model_of(needy)
    able = {0: {0, 3}, 1: {0, 1, 2, 3}, 2: {3}}
    for robot, visits in able.items():
        for visit in range(4):
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


@pytest.mark.parametrize(("latest_s", "fits"), [(5.0, True), (4.9, False)])
def test_a_job_must_end_in_time(latest_s, fits):
    assert is_feasible(model_of(line([job("a", 3, service_s=2.0, latest_s=latest_s)], [worker("r1")])), [0]) is fits


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


def test_visits_that_must_be_made_are_required():
    problem = line([job("a", 1), job("b", 2)], [worker("r1")])
    arrays = make_arrays(problem)
    model = VrpModel(problem, arrays, arrays.visits, np.array([False, True]), Objective.ENERGY)
    assert [client.required for client in model.data.clients()] == [False, True]


def test_the_robots_of_a_job_share_its_prize():
    problem = line([job("alone", 1), job("lift", 2, robots=2)], [worker("r1"), worker("r2")])
    assert make_arrays(problem).visits.prize_j.tolist() == [10.0, 5.0, 5.0]
    alone, one, other = (client.prize for client in model_of(problem).data.clients())
    assert one == other == pytest.approx(alone / 2, rel=1e-3)


@pytest.mark.parametrize("most_cells", [0, 1e7])
def test_a_robot_is_not_given_what_it_is_forbidden_or_what_is_for_those_that_are_ready(monkeypatch, most_cells):
    monkeypatch.setattr(vrp_model, "MOST_CELLS", most_cells)
    jobs = [job("not r1", 1, forbidden_workers=frozenset({"r1"})), job("now", 2, ready_only=True), job("any", 3)]
    model = model_of(line(jobs, [worker("r1"), worker("r2"), worker("r3", ready_s=1.0)]))
    able = {0: {1, 2}, 1: {0, 1, 2}, 2: {0, 2}}
    for robot, visits in able.items():
        for visit in range(3):
            orders: list[list[int]] = [[], [], []]
            orders[robot] = [visit]
            assert is_feasible(model, *orders) is (visit in visits), (robot, visit)


def test_all_kernels_of_a_plan_are_compiled_before_the_run():
    """A coordinator whose first plan compiles one is late by a second."""
    warm_up()
    before = set(fill_matrix.signatures)
    OptimalAllocator(Objective.ENERGY, lambda: 0.0).plan(team_problem(3, 6, 1), iterations=2)
    assert set(fill_matrix.signatures) == before
