"""The warehouse and the office ring of `examples/maps`: what their comments say of them is so."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from robrain import Scenario
from robrain.protocol.model.geometry import Point2D
from robrain.sim.maps.map_server import load_map

FOLDER = Path(__file__).parents[3] / "examples" / "maps"
NAMES = ("warehouse", "office_ring")
ROBOTS, RADIUS_M = 8, 0.2


@pytest.fixture(scope="module")
def drawing():
    """The script that draws both."""
    spec = importlib.util.spec_from_file_location("draw_floors", FOLDER / "draw_floors.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module", params=NAMES)
def plan(request):
    return load_map(FOLDER / f"{request.param}.yaml")


def free_m(plan, from_m, to_m):
    """Lengths of the free stretches on a straight line along an axis, between places."""
    (row, column), (last_row, last_column) = plan.cell_of(*from_m), plan.cell_of(*to_m)
    line = ~plan.occupied[row : last_row + 1, column : last_column + 1].ravel()
    edges = np.flatnonzero(np.diff(np.concatenate(([0], line.astype(np.int8), [0]))))
    return [round(float(length), 3) for length in (edges[1::2] - edges[::2]) * plan.resolution_m]


@pytest.mark.parametrize("name", NAMES)
def test_image_is_what_the_script_draws(name, drawing):
    plan = load_map(FOLDER / f"{name}.yaml")
    assert np.array_equal(plan.occupied, drawing.occupied_cells(name))


@pytest.mark.slow
def test_all_free_floor_is_reached_by_a_robot_from_anywhere_on_it(plan):
    _, regions = ndimage.label(~plan.occupied)
    assert regions == 1
    _, regions = ndimage.label(plan.clearance_m >= RADIUS_M + 0.1)
    assert regions == 1


def test_warehouse_is_of_equal_aisles_wide_enough_for_two_robots():
    plan = load_map(FOLDER / "warehouse.yaml")
    assert plan.size_m == (60.0, 40.0)
    for x_m in (3.5, 24.5, 29.0, 50.0):
        assert free_m(plan, (x_m, 0.05), (x_m, 39.95)) == [2.9] * 10
    assert free_m(plan, (0.05, 3.5), (54.0, 3.5)) == [2.9, 3.5, pytest.approx(3.5, abs=0.1)]
    assert [len(free_m(plan, (3.0, y_m), (24.95, y_m))) for y_m in np.arange(3.5, 39.0, 4.1)] == [
        0, 0, 1, 0, 0, 0, 1, 0, 0,
    ]  # fmt: skip


def test_office_ring_is_a_loop_of_128_m_with_doors_a_robot_goes_through():
    plan = load_map(FOLDER / "office_ring.yaml")
    assert plan.size_m == (50.0, 40.0)
    west, east, south, north = 6.5, 43.5, 6.5, 33.5
    assert 2 * (east - west + north - south) == 128.0
    for x_m in (20.0, 30.0):
        for y_m in (south, north):
            (width_m,) = free_m(plan, (x_m, y_m - 0.9), (x_m, y_m + 0.9))
            assert width_m >= 1.75
    for from_m, to_m in [((west, south), (east, south)), ((west, north), (east, north))]:
        assert free_m(plan, from_m, to_m) == [pytest.approx(37.0, abs=0.1)]
    doors_m = free_m(plan, (5.6, 5.5), (44.4, 5.5)) + free_m(plan, (5.5, 5.7), (5.5, 34.3))
    assert len(doors_m) == 12
    assert all(0.9 <= width_m <= 1.0 for width_m in doors_m)
    closed_m = free_m(plan, (9.3, 34.5), (40.8, 34.5)) + free_m(plan, (11.2, 32.5), (35.8, 32.5))
    assert closed_m == []


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_eight_robots_start_on_it_and_explore_without_touching(name):
    scenario = Scenario.from_map(FOLDER / f"{name}.yaml", robots=ROBOTS)
    result = scenario.run(time_limit_s=1.5)
    assert (result.robots, result.collisions) == (ROBOTS, 0)
    assert result.distance_m > 1.0
    near = [Point2D(robot.pose.x_m, robot.pose.y_m) for robot in result.per_robot]
    assert len(set(near)) == ROBOTS
