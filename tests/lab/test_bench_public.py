"""Public routing instances: what can be read, what is solved, and what is said of what cannot be compared."""

from pathlib import Path

import pytest

from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.problem import Objective
from robrain.algorithms.allocation.warm_up import warm_up
from robrain.deploy.errors import InstanceError
from robrain.lab.bench.public import read_best, read_public, solve_public

R101 = Path(__file__).parents[1] / "algorithms" / "allocation" / "data" / "R101_25.txt"
SQUARE = """NAME : {name}
TYPE : CVRP
DIMENSION : 5
EDGE_WEIGHT_TYPE : EUC_2D
{specs}
NODE_COORD_SECTION
1 0 0
2 10 0
3 10 10
4 0 10
5 5 15
{sections}
EOF
"""
DEMANDS = "DEMAND_SECTION\n1 0\n2 4\n3 4\n4 4\n5 4\nDEPOT_SECTION\n1\n-1"


def never():
    raise AssertionError("the clock is not read where only iterations count")


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    warm_up()


@pytest.fixture
def written(tmp_path):
    def write(specs="", sections="", name="square"):
        path = tmp_path / f"{name}.vrp"
        path.write_text(SQUARE.format(name=name, specs=specs, sections=sections).replace("\n\n", "\n"))
        return path

    return write


def solve(path, best=None, iterations=400):
    allocator = OptimalAllocator(Objective.ENERGY, never)
    return solve_public(read_public(path), allocator, best, iterations=iterations)


@pytest.mark.slow
def test_published_optimum_of_solomons_r101_is_found_with_no_gap():
    result = solve(R101, 617.1, 3000)
    assert (result.value, result.vehicles, result.remark) == (617.1, 8, "")
    assert result.gap == pytest.approx(0.0, abs=1e-9)
    assert sorted(customer for route in result.routes for customer in route) == list(range(1, 26))


def test_instance_without_capacity_is_one_salesmans_tour(written):
    result = solve(written())
    assert result.vehicles == 1
    assert result.value == 10 + 10 + 7 + 7 + 10  # ways of 7.07 count as 7, as TSPLIB has it
    assert result.gap is None


def test_plan_that_exceeds_a_capacity_is_not_compared_and_says_why(written):
    result = solve(written("CAPACITY : 8", DEMANDS), best=60.0)
    assert result.over_capacity == 1
    assert result.gap is None
    assert "capacit" in result.remark


def test_limit_of_a_routes_length_is_kept(written):
    result = solve(written("CAPACITY : 100\nDISTANCE : 40", DEMANDS))
    assert result.vehicles == 2
    assert result.left_out == 0


def test_best_known_value_is_that_of_the_solution_beside(written):
    path = written()
    assert read_best(path) is None
    path.with_suffix(".sol").write_text("Route #1: 1 2 4 3\nCost 44\n")
    assert read_best(path) == 44.0
    assert solve(path, read_best(path)).gap == 0.0


@pytest.mark.parametrize(
    ("specs", "sections", "named"),
    [
        ("", "DEPOT_SECTION\n2\n-1", "DEPOT_SECTION: expected node 1 as the only depot"),  # another node than the first
        ("", "DEPOT_SECTION\n1\n2\n-1", "DEPOT_SECTION: expected node 1 as the only depot"),  # two of them
        ("", "BACKHAUL_SECTION\n2\n-1", "BACKHAUL_SECTION: not supported by the allocators' model"),
        ("VEHICLES : none", "", "none"),  # not a number
    ],
)
def test_what_the_model_does_not_hold_is_named_with_file_and_key(written, specs, sections, named):
    with pytest.raises(InstanceError, match=named) as refused:
        read_public(written(specs, sections))
    assert "square.vrp" in str(refused.value)


def test_file_that_is_no_instance_is_named(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("nothing\n")
    with pytest.raises(InstanceError, match=r"notes\.txt: cannot be read as a solomon file"):
        read_public(path)
    with pytest.raises(InstanceError, match=r"gone\.vrp: No such file"):
        read_public(tmp_path / "gone.vrp")
