"""Public routing instances: what can be read, what is solved, and what is said of what cannot be compared."""

import tomllib
from pathlib import Path

import pytest

from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.problem import Objective
from robrain.algorithms.allocation.warm_up import warm_up
from robrain.deploy.errors import InstanceError, UsageError
from robrain.lab.bench.allocation import BEST_FILE, choose, read_best, read_public, run_bench, solve_alone, solve_public

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


def solve(path, iterations=400):
    return solve_public(read_public(path), OptimalAllocator(Objective.ENERGY, never), iterations=iterations)


@pytest.mark.slow
def test_published_optimum_of_solomons_r101_is_found_with_no_gap():
    result = solve(R101, 3000)
    assert (result.value, result.vehicles, result.remark) == (617.1, 8, "")
    assert sorted(customer for route in result.routes for customer in route) == list(range(1, 26))


def test_instance_without_capacity_is_one_salesmans_tour(written):
    result = solve(written())
    assert result.vehicles == 1
    assert result.value == 10 + 10 + 7 + 7 + 10  # ways of 7.07 count as 7, as TSPLIB has it
    assert result.gap is None


def test_capacities_are_kept(written):
    result = solve(written("CAPACITY : 8", DEMANDS))
    assert (result.vehicles, result.value) == (2, 67.0)  # 0-1-2-0 and 0-3-4-0


def test_customers_that_are_left_out_are_named_and_nothing_is_compared(written):
    path = written("CAPACITY : 3", DEMANDS)
    path.with_suffix(".sol").write_text("Cost 44\n")
    result = solve(path)
    assert (result.left_out, result.gap) == (4, None)
    assert "cannot carry 4 kg more" in result.remark


PAIRS = """2\t5\t1
0\t0\t0\t0\t0\t100\t0\t0\t0
1\t{x}\t0\t5\t0\t90\t1\t0\t2
2\t20\t0\t-5\t0\t90\t1\t1\t0
3\t20\t0\t5\t0\t90\t1\t0\t4
4\t10\t0\t-5\t0\t90\t1\t3\t0
"""


def test_pickups_come_before_their_deliveries_in_li_and_lims_format(tmp_path):
    path = tmp_path / "two.txt"
    path.write_text(PAIRS.format(x=10))
    result = solve(path)
    assert (result.value, result.routes) == (40.0, [[1, 2, 3, 4]])
    alone = solve_alone(read_public(path), deadline_s=0.05)
    assert (alone.value, alone.routes) == (40.0, [[1, 2, 3, 4]])


STATIONS = """StringID   Type  x  y  demand  ReadyTime  DueDate  ServiceTime
D0  d   0.0  0.0  0.0  0.0  {horizon}  0.0
S1  f   5.0  0.0  0.0  0.0  {horizon}  0.0
C1  c   9.0  0.0  4.0  0.0  90.0  1.0
C2  c   8.0  0.0  4.0  0.0  90.0  1.0

Q Vehicle fuel tank capacity /10.0/
C Vehicle load capacity /8.0/
r fuel consumption rate /1.0/
g inverse refueling rate /2.0/
v average Velocity /1.0/
"""


@pytest.mark.parametrize(
    ("horizon", "value"),
    [
        ("46.0", 18.0),  # one vehicle: 18 of drive, 2 of service, 26 of charge
        ("45.9", 34.0),  # too short for that, so there are two
    ],
)
def test_vehicles_charge_at_the_stations_of_schneiders_format(tmp_path, horizon, value):
    path = tmp_path / "two.txt"
    path.write_text(STATIONS.format(horizon=horizon))
    result = solve(path, 20)
    assert (result.left_out, result.value) == (0, value)


def test_benchmark_with_stations_has_no_figure_of_pyvrp(tmp_path, capsys):
    path = tmp_path / "c101C5.txt"  # its name has a best known value
    path.write_text(STATIONS.format(horizon="46.0"))
    report = tmp_path / "figures.json"
    run_bench(choose([path], 0.05, 0), report)
    assert "PyVRP" not in capsys.readouterr().out
    assert b"gap to the best known values, with charging" in report.read_bytes()


def test_windows_and_capacity_of_pyvrp_alone_are_those_of_the_file(written):
    alone = solve_alone(read_public(written("CAPACITY : 8", DEMANDS)), deadline_s=0.05)
    assert (alone.vehicles, alone.value) == (2, 67.0)  # 0-1-2-0 and 0-3-4-0


def test_best_known_value_and_number_of_vehicles_come_from_the_table(tmp_path, monkeypatch):
    table = tmp_path / "best.toml"
    table.write_text("[li_lim]\ntwo = [32.0, 1]\n")
    monkeypatch.setattr("robrain.lab.bench.allocation.BEST_FILE", table)
    path = tmp_path / "TWO.txt"
    path.write_text(PAIRS.format(x=10))
    instance = read_public(path)
    assert (instance.best, len(instance.problem.workers)) == (32.0, 1)
    assert solve(path).gap == 0.25


def test_table_of_best_known_values_has_a_distance_and_maybe_vehicles_for_each():
    for table in tomllib.loads(BEST_FILE.read_text()).values():
        assert all(len(known) in (1, 2) and all(value > 0 for value in known) for known in table.values())


def test_benchmark_of_a_folder_compares_each_instance_with_pyvrp_alone(tmp_path, capsys):
    (tmp_path / "two.txt").write_text(PAIRS.format(x=10))
    (tmp_path / "notes.md").write_text("no instance")
    report = tmp_path / "figures.json"
    run_bench(choose([tmp_path], 0.05, 0), report)
    assert "two: robrain 1 vehicles, distance 40.00; PyVRP alone 1 vehicles, distance 40.00" in capsys.readouterr().out
    assert b"distance beyond PyVRP alone" in report.read_bytes()
    with pytest.raises(UsageError, match="--seconds 0"):
        choose([tmp_path], 0.0, 0)


def test_limit_of_a_routes_length_is_kept(written):
    result = solve(written("CAPACITY : 100\nDISTANCE : 40", DEMANDS))
    assert result.vehicles == 2
    assert result.left_out == 0


def test_best_known_value_is_that_of_the_solution_beside(written):
    path = written()
    assert read_best(path) is None
    path.with_suffix(".sol").write_text("Route #1: 1 2 4 3\nCost 44\n")
    assert read_best(path) == 44.0
    assert solve(path).gap == 0.0


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
    path.write_text(PAIRS.format(x="x"))
    with pytest.raises(InstanceError, match=r"notes\.txt: cannot be read as a li_lim file"):
        read_public(path)
    with pytest.raises(InstanceError, match=r"gone\.vrp: No such file"):
        read_public(tmp_path / "gone.vrp")
