"""What a task and the path home may cost, with parts that say what the test wants."""

from types import SimpleNamespace

import pytest

from robrain.plugins.behavior.budget import DETOUR, Budget
from robrain.plugins.skill.home import ChargerPlace
from robrain.protocol.model.energy_model import Work, estimate
from robrain.protocol.model.geometry import Point2D
from tests.energy_models import energy_model
from tests.plugins.behavior.bare_errand import BareErrand, other

NEAR, FAR = ChargerPlace(3.0, 4.0), ChargerPlace(30.0, 40.0)
HERE = Point2D(0.0, 0.0)
MODEL = energy_model(5.0, 4.0, 6.0, 2.0, 0.0, relative_sd=0.2)


def budget(robot: BareErrand) -> Budget:
    """A robot whose planner finds no path."""
    parts = {
        "energy": SimpleNamespace(estimate=lambda work: estimate(MODEL, work), usable_j=lambda: robot.usable_j),
        "home": robot.budget.home,
        "planner": SimpleNamespace(plan=lambda *_places, **_options: None),
    }
    robot.env.use = lambda name, _interface: parts[name]
    robot.travel.view = lambda: None
    found = Budget(robot.env, robot.travel)
    found.connect()
    return found


def test_a_task_needs_the_bound_of_its_cost_and_of_the_path_home_and_not_the_mean():
    robot = BareErrand()
    both = estimate(MODEL, Work(path_m=30.0))
    assert both.high_j(0.95) > 1.1 * both.mean_j
    assert budget(robot).judge(Work(path_m=10.0), 20.0).needed_j == pytest.approx(both.high_j(0.95))


def test_the_path_home_is_that_to_the_nearest_free_charger_and_longer_than_straight_where_it_is_unknown():
    robot = BareErrand(NEAR, FAR)
    assert budget(robot).path_home(HERE) == (NEAR, 5.0 * DETOUR)
    robot.others = [other("r1", 3.0, 4.0)]
    assert budget(robot).path_home(HERE) == (FAR, 50.0 * DETOUR)
    robot.others.append(other("r2", 30.0, 40.0))
    assert budget(robot).path_home(HERE) == (NEAR, 5.0 * DETOUR)  # to wait there is better than to run empty
