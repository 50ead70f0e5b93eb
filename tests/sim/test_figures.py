"""Deterministic figures, compared with their bounds and with the pages.

After a change that affects them, run `make bench ARGS=exploration`, then `make figures`.
"""

from unittest import mock

import numpy as np
import pytest

from robrain import Scenario
from robrain.lab.bench.figure import Figure, FigureKind
from robrain.plugins.unit.driver.driver import Driver
from robrain.protocol.model.geometry import Point2D
from robrain.sim.maps.map_server import load_map
from tests.bench import exploration
from tests.bench.call_count import calls_per_robot_second
from tests.bench.results import Results

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
PRINTED = Results.read().named()
SMALL = Scenario.builtin("arena_small").replace(robots=1)


def missed(figures: list[Figure]) -> list[str]:
    """Messages for deterministic figures that miss their bound."""
    fixed = [figure for figure in figures if figure.kind is FigureKind.DETERMINISTIC]
    assert fixed
    return [
        f"{figure.name}: {figure.value_text()}, bound {figure.bound_text()}" for figure in fixed if figure.kept is False
    ]


def misprinted(section: str, figures: list[Figure]) -> list[str]:
    """Messages for figures that differ from the pages."""
    fixed = [figure for figure in figures if figure.kind is FigureKind.DETERMINISTIC]
    printed = {figure.name: PRINTED.get((section, figure.name)) for figure in fixed}
    return [
        f"{figure.name}: measured {figure.value_text()}, printed {old.value_text() if old else 'nothing'}"
        for figure in fixed
        if (old := printed[figure.name]) is None or old.value_text() != figure.value_text()
    ]


def test_map_is_explored_in_time_without_collisions_as_the_pages_print() -> None:
    """`make bench` compares the real maps too."""
    figures = exploration.run_figures(exploration.OWN, exploration.OWN.run())
    assert missed(figures) == []
    assert misprinted("exploration", figures) == []


def test_calls_are_counted_alike_in_each_run_and_a_call_more_a_step_is_seen() -> None:
    def count() -> float:
        return calls_per_robot_second(SMALL, settle_s=1.0, window_s=2.0)

    step, steps = Driver.step, 0

    def costlier(driver: Driver) -> None:
        nonlocal steps
        steps += 1
        step(driver)

    count()  # what is cached for good in the first run is not called again
    before = count()
    assert count() == before
    with mock.patch.object(Driver, "step", costlier):
        after = count()
    assert after - before == pytest.approx(steps / 3.0, rel=0.1)  # steps of three seconds, two of them counted
    assert after > before + 10


def test_map_of_the_project_has_a_shaft_that_no_robot_reaches() -> None:
    plan = load_map(exploration.OWN.map_path)
    assert plan.size_m == pytest.approx((15.0, 11.0))
    reachable = plan.reachable([Point2D(0.0, 3.0)], 0.2)
    x_m, y_m = 11.8, 5.7
    cell = round((y_m - plan.origin_y_m) / plan.resolution_m), round((x_m - plan.origin_x_m) / plan.resolution_m)
    assert not plan.occupied[cell]
    assert not reachable[cell]
    assert np.count_nonzero(reachable) * plan.resolution_m**2 == pytest.approx(118, abs=2)
