"""Ideal motion: points at top speed explore by the same strategies as the full stack."""

from itertools import pairwise

import numpy as np
import pytest

from robrain.algorithms.exploration.strategies import joint
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.sim.ideal.ideal_run import IdealResult, run_ideal
from robrain.sim.ideal.ideal_team import SPEED_M_S, IdealTeam
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.robot.lidar import LidarSpec
from robrain.sim.scenarios.scenario import Scenario

RADIUS_M = 0.2


def rooms(door_m: float) -> FloorPlan:
    """Two rooms of 6 × 4 m side by side, joined by a door of this width."""
    occupied = np.ones((44, 124), dtype=np.bool_)
    occupied[2:42, 2:61] = False
    occupied[2:42, 63:122] = False
    middle, half = 22, round(door_m / 0.2)
    occupied[middle - half : middle + half, 61:63] = False
    return FloorPlan(occupied, 0.1, 0.0, 0.0, "rooms")


def team(plan: FloorPlan, *starts: tuple[float, float], revise_s: float = 0.0, seed: int = 1) -> IdealTeam:
    poses = [Pose2D(x_m, y_m, 0.0) for x_m, y_m in starts]
    return IdealTeam(plan, poses, RADIUS_M, LidarSpec(), joint, revise_s, np.random.default_rng(seed))


def explore(one: IdealTeam, limit_s: float = 60.0) -> IdealTeam:
    while one.explored_fraction < 0.99 and one.time_s < limit_s:
        one.step()
    return one


def test_an_ideal_team_explores_both_rooms_through_the_door() -> None:
    assert explore(team(rooms(0.8), (1.0, 1.0))).explored_fraction >= 0.99


def test_no_robot_drives_through_a_door_that_is_too_narrow_for_it() -> None:
    one = explore(team(rooms(0.4), (1.0, 2.0)), limit_s=20.0)
    assert one.robots[0].x_m < 6.2


def test_robots_drive_at_top_speed_and_never_through_walls() -> None:
    plan = rooms(0.8)
    one = team(plan, (1.0, 1.0), (1.5, 2.5))
    places = [[robot.place for robot in one.robots]]
    while one.explored_fraction < 0.99:
        one.step()
        places.append([robot.place for robot in one.robots])
    step_s = 1.0 / LidarSpec().rate_hz
    for before, after in pairwise(places):
        for start, end in zip(before, after, strict=True):
            assert start.distance_m(end) <= SPEED_M_S * step_s + 1e-9
            assert plan.contains_free(end.x_m, end.y_m)
    assert one.robots[0].distance_m == pytest.approx(
        sum(before[0].distance_m(after[0]) for before, after in pairwise(places)), rel=0.1
    )


def test_distance_and_standing_add_up_to_the_time() -> None:
    one = explore(team(rooms(0.8), (1.0, 1.0)))
    robot = one.robots[0]
    assert robot.distance_m / SPEED_M_S + robot.standing_s == pytest.approx(one.time_s, abs=2.0)


def test_equal_seeds_give_equal_runs_and_others_do_not() -> None:
    def run(seed: int) -> IdealResult:
        return run_ideal(Scenario.builtin("arena_small").replace(seed=seed, robots=2))

    assert run(3) == run(3)
    assert run(3) != run(4)


@pytest.mark.parametrize("strategy", ["auto", "nearest", "minpos", "burgard", "joint", "rooms", "tours"])
@pytest.mark.parametrize("revise_s", [0.0, 1.0])
def test_each_strategy_explores_a_floor(strategy: str, revise_s: float) -> None:
    policy = PlanningPolicy(exploration=strategy, revise_s=revise_s)
    result = run_ideal(Scenario.builtin("arena_small").replace(seed=3, robots=3, planning=policy))
    assert result.explored_fraction >= 0.98
    reached = [percent for percent in (50, 90, 95, 99) if result.explored_fraction >= percent / 100]
    assert sorted(result.explored_percent_s) == reached
    assert result.distance_m > 0


def test_a_run_ends_when_nothing_is_left_that_a_robot_can_see() -> None:
    result = run_ideal(Scenario.builtin("arena_small").replace(seed=3, robots=2, until_explored=1.0))
    assert result.sim_time_s < Scenario.builtin("arena_small").time_limit_s / 2


def test_a_robot_starts_where_the_scenario_says() -> None:
    scenario = Scenario.builtin("arena_small").replace(near=Point2D(2.0, 2.0), robots=1)
    assert scenario.world().robots[0].start.distance_m(Point2D(2.0, 2.0)) < 0.5
