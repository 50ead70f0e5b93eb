"""The exploration benchmark: which runs its options ask for, what it tells of them, and what it refuses."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.lab.bench.exploration import (
    FULL,
    POINTS,
    ExplorationCase,
    ExplorationRun,
    bound_s,
    choose,
    figures,
    run_bench,
    run_case,
)
from robrain.lab.bench.mapping_plan import BenchPlan
from robrain.protocol.model.geometry import Point2D
from robrain.sim.maps.floor_plan import FloorPlan

DEFAULT = PlanningPolicy().exploration
SMALL = ExplorationCase(
    map="arena_small", path="", robots=2, seed=3, strategy=DEFAULT, motion=POINTS, time_limit_s=120.0
)


def chosen(**options: object) -> BenchPlan[ExplorationCase]:
    words = {
        "maps": "arena_small",
        "robots": "2",
        "seeds": "3",
        "strategies": DEFAULT,
        "motions": POINTS,
        "near": None,
        "jobs": 1,
        "time_limit_s": 120.0,
    }
    return choose(**(words | options))


def run_of(time_s: float | None, **case: object) -> ExplorationRun:
    """A run of the whole stack that has seen 95 % at a time."""
    reached = {} if time_s is None else {90: time_s - 1.0, 95: time_s}
    asked = msgspec.structs.replace(SMALL, **({"motion": FULL} | case))
    return ExplorationRun(case=asked, explored_percent_s=reached, bound_s=10.0, distance_m=5.0, explored_m2=20.0)


def bounds_of(runs: list[ExplorationRun]) -> dict[str, tuple[float | None, bool | None]]:
    return {figure.name: (figure.value, figure.kept) for figure in figures(runs)}


def test_every_map_comes_with_every_team_strategy_motion_and_seed() -> None:
    plan = chosen(
        maps="clinic,arena_small", robots="1,4", seeds="1-3", strategies="joint,minpos", motions="full,points"
    )
    assert len(plan.cases) == len(set(plan.cases)) == 2 * 2 * 3 * 2 * 2


@pytest.mark.slow
def test_points_and_full_runs_explore_the_same_floor_from_the_same_place() -> None:
    near = (2.0, 2.0)
    points, full = (run_case(msgspec.structs.replace(SMALL, motion=motion, near=near)) for motion in (POINTS, FULL))
    assert points.explored_m2 == pytest.approx(full.explored_m2, rel=0.03)
    assert points.bound_s == full.bound_s > 0
    assert full.bound_s <= points.explored_percent_s[95] <= 1.1 * full.explored_percent_s[95]
    assert full.energy_j > 0.0
    assert full.overlap > 0.0


def test_the_bound_is_the_way_to_the_farthest_floor_less_the_sight() -> None:
    corridor = np.ones((14, 404), dtype=np.bool_)
    corridor[2:12, 2:402] = False
    plan = FloorPlan(corridor, 0.1, 0.0, 0.0, "corridor")
    assert bound_s(plan, Point2D(1.0, 0.7), 0.2, 6.0, speed_m_s=0.5) == pytest.approx((37.0 - 6.0) / 0.5, rel=0.03)
    assert bound_s(plan, Point2D(1.0, 0.7), 0.2, 60.0) == 0.0


def test_a_team_is_judged_by_the_best_strategy_of_one_robot() -> None:
    runs = [run_of(96.0, robots=1), run_of(80.0, robots=1, strategy="minpos"), run_of(30.0, robots=4)]
    bounds = {figure.name: figure.bound for figure in figures(runs)}
    assert bounds["arena_small, 4 robots: 95 % known"].at_most == pytest.approx(80.0 / 3.2)
    assert bounds_of(runs)["arena_small, 4 robots: 95 % known"] == (30.0, False)


def test_a_run_that_did_not_come_so_far_misses_its_bound() -> None:
    runs = [run_of(40.0, robots=1), run_of(14.0, robots=8), run_of(None, robots=8, seed=4)]
    assert bounds_of(runs)["arena_small, 8 robots: 95 % known"] == (None, False)


def test_full_runs_are_judged_beside_points_and_the_default_beside_the_best() -> None:
    runs = [run_of(24.0, robots=1), run_of(20.0, robots=1, motion=POINTS), run_of(23.0, robots=1, strategy="minpos")]
    told = bounds_of(runs)
    assert told["arena_small, 1 robots: time over that of points"] == (pytest.approx(1.2), False)
    assert told["arena_small, 1 robots: time over the best"] == (pytest.approx(24 / 23), False)


@pytest.mark.slow
def test_the_file_has_all_runs_and_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = chosen(robots="1,2")
    run_bench(plan, tmp_path / "out.json")
    written = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert [run["case"]["robots"] for run in written["runs"]] == [1, 2]
    assert f"arena_small, 2 robots, {DEFAULT}, points: 90 % after" in capsys.readouterr().out
