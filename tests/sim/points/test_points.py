"""Runs of the fidelity `points`: host, behaviors and coordinator are real, robots are points."""

import math
from itertools import pairwise

import numpy as np
import pytest

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.errors import ScenarioError
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec
from robrain.sim.points.point_team import POINT_TICK_S, PointFloor, PointTeam
from robrain.sim.robot.robot_hardware import ArenaRobot
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.chargers import ChargerSpec
from robrain.sim.world.robot_specs import RobotSpec
from robrain.sim.world.scenario_tasks import TaskSpec


def arena(**changes: object) -> Scenario:
    return Scenario.builtin("arena_small").replace(fidelity="points", **changes)


def test_one_robot_explores_and_then_visits() -> None:
    visit = TaskSpec(kind="visit", place_m=(1.0, 1.0), name="there", at_s=1.0)
    result = arena(robots=1, motes=0, tasks=(visit,)).run()
    assert result.ended == "explored"
    assert result.explored_fraction > 0.98
    assert result.map_accuracy is not None
    assert result.map_accuracy.cells_off == 0
    assert [task.state for task in result.tasks] == [TaskState.DONE]
    assert 0.3 * result.sim_time_s < result.distance_m <= 0.6 * result.sim_time_s


def test_points_keep_clear_of_walls_and_drive_at_top_speed() -> None:
    places: list[list[tuple[float, float]]] = []
    scenario = arena(robots=2, motes=0)
    with scenario.team() as team:
        run = team.transport.run
        for _ in range(40):
            run.tick()
            places.append([(body.x_m, body.y_m) for body in run.arena.bodies])
        plan, step_m = run.world.plan, 0.6 * run.tick_s
    for before, after in pairwise(places):
        for start, end in zip(before, after, strict=True):
            assert math.dist(start, end) <= step_m + 1e-9
            assert plan.contains_free(*end)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["nearest", "minpos", "burgard", "joint", "rooms", "tours"])
def test_each_strategy_explores_a_floor(strategy: str) -> None:
    result = arena(seed=3, robots=3, planning=PlanningPolicy(exploration=strategy)).run()
    assert result.explored_fraction >= 0.98


@pytest.mark.slow
def test_equal_seeds_give_equal_digests() -> None:
    one, other = (arena(seed=5).run(time_limit_s=3.0) for _ in range(2))
    assert one.digest == other.digest
    assert one.digest != arena(seed=6).run(time_limit_s=3.0).digest


def test_energy_follows_the_model() -> None:
    scenario = arena(robots=1, motes=0, idle=True)
    result = scenario.run(time_limit_s=10.0)
    standing_j = 10.0 * scenario.hardware.power.idle_total_w(bursting=False)
    assert result.energy_j == pytest.approx(standing_j)
    assert result.distance_m == 0.0


def test_a_charger_fills_the_battery() -> None:
    dock = ChargerSpec(place_m=(1.0, 1.0))
    empty = RobotSpec(place_m=(1.0, 1.0), hardware={"battery": {"soc_at_start": 0.3}})
    charge = TaskSpec(kind="recharge", place_m=(1.0, 1.0), at_s=0.5, parameters={"until_soc": 0.31})
    result = arena(robots=1, roster=(empty,), motes=0, idle=True, chargers=(dock,), tasks=(charge,)).run()
    assert [task.state for task in result.tasks] == [TaskState.DONE]


def test_what_points_cannot_have_is_refused() -> None:
    cut = FaultSpec(robot="r1", kind=FaultKind.CAN_CUT, at_s=1.0)
    with pytest.raises(ScenarioError, match="can_cut"):
        arena(faults=(cut,)).run()
    with pytest.raises(ScenarioError, match="fidelity"):
        arena().replace(fidelity="cubes")


def test_points_stop_before_they_touch_each_other() -> None:
    fast, slow = ArenaRobot(name="r1", start=Pose2D(0.0, 0.0, 0.0)), ArenaRobot(name="r2", start=Pose2D(2.0, 0.0, 0.0))
    floor = PointFloor(np.zeros((10, 10), np.bool_), GridGeometry(1.0, -2.0, -2.0, 10, 10))
    team = PointTeam([fast, slow], floor, POINT_TICK_S)
    one, other = team.robots
    one.follow([Point2D(4.0, 0.0)], 0.6)
    for tick in range(30):
        one.command()
        team.move(tick)
    assert 0.4 < other.x_m - one.x_m < 0.6
    assert one.blocked_s > 2.0
    one.follow([Point2D(-1.0, 0.0)], 0.6)  # away from it
    team.move(31)
    assert one.blocked_s == 0.0
