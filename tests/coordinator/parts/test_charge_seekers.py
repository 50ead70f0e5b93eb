"""Robots as the schedule of the chargers takes them: how far it is for each to which charger, and who is none."""

import math
from types import SimpleNamespace

import msgspec
import pytest

from robrain.coordinator.parts.charging import CHARGED_SOC, STILL_M, ChargeSeekers
from robrain.coordinator.planning.energy_budget import CHARGED_SHARE, DETOUR
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import ChargerDistances
from robrain.coordinator.team.chargers import Charger
from robrain.coordinator.team.roster import Robot
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.model.geometry import Point2D, Pose2D
from tests.coordinator.planning.worlds import CAPACITY_J, J_PER_M, PACE_M_S, STANDING_W, model

HERE = Point2D(1.0, 2.0)
NEAR, FAR = Point2D(4.0, 6.0), Point2D(1.0, 12.0)
S_PER_M = 2.0
"""With a margin of none at all."""


class World:
    """One robot that is to charge, and what the plan knows of its ways."""

    def __init__(self, soc: float = 0.3) -> None:
        self.known: ChargerDistances | None = None
        self.out = ""
        self.route = False
        self.planning = SimpleNamespace(
            policy=PlanningPolicy(time_margin=S_PER_M * PACE_M_S, reserve_share=0.1),
            chargers=SimpleNamespace(of={"r1": (Charger(NEAR), Charger(FAR))}),
            charger_distances_m=lambda _robot: self.known,
            exclusion=lambda _robot, _now_ns: self.out,
            route_energy_j=lambda _robot: None,
            has_route=lambda _robot: self.route,
        )
        self.watch = ChargeSeekers(self.planning, SimpleNamespace(), SimpleNamespace())
        self.robot = Robot("r1")
        battery = BatteryState(
            voltage_v=16.0, current_a=1.0, temperature_c=20.0, soc=soc, remaining_j=soc * CAPACITY_J,
            remaining_low_j=soc * CAPACITY_J, remaining_high_j=soc * CAPACITY_J, charging=False,
        )  # fmt: skip
        pose = Pose2D(HERE.x_m, HERE.y_m, 0.0)
        self.robot.state = RobotState(robot="r1", pose=pose, energy=model(soc * CAPACITY_J), battery=battery)

    def change(self, **fields) -> None:
        self.robot.state = msgspec.structs.replace(self.robot.state, **fields)

    def seeker(self, *, below=0.35, is_paused=False):
        return self.watch.seeker(self.robot, None, below, is_paused, 0)

    def paths_m(self) -> dict[Point2D, float]:
        return {way.charger: way[1] / S_PER_M for way in self.seeker().paths}


def test_a_way_that_no_plan_knows_is_taken_to_be_a_detour():
    assert World().paths_m() == pytest.approx({NEAR: DETOUR * 5.0, FAR: DETOUR * 10.0})


@pytest.mark.parametrize(
    ("away_m", "near_m"), [(0.0, 7.0), (0.99 * STILL_M, 7.0), (STILL_M, DETOUR * 5.0), (5.0, DETOUR * 5.0)]
)
def test_as_long_as_a_robot_stands_still_the_last_plan_knows_the_ways(away_m, near_m):
    world = World()
    world.known = ChargerDistances(Point2D(HERE.x_m - away_m, HERE.y_m), ((NEAR, 7.0),))
    assert world.paths_m() == pytest.approx({NEAR: near_m, FAR: DETOUR * 10.0})


def test_to_a_charger_without_a_way_no_robot_goes():
    world = World()
    world.known = ChargerDistances(HERE, ((NEAR, float("inf")), (FAR, 30.0)))
    assert world.paths_m() == pytest.approx({FAR: 30.0})


def test_only_chargers_that_are_reached_with_the_reserve_count_or_else_the_nearest():
    world = World()
    j_per_m = J_PER_M + STANDING_W / PACE_M_S
    spare_j = 0.1 * CAPACITY_J + 1.3 * j_per_m * DETOUR * 5.0
    world.change(energy=model(spare_j))
    assert set(world.paths_m()) == {NEAR}
    world.change(energy=model(0.0))
    assert set(world.paths_m()) == {NEAR}
    world.change(energy=None)
    assert set(world.paths_m()) == {NEAR, FAR}


def test_only_who_has_little_left_is_to_charge():
    world = World()
    assert world.seeker(below=0.3) is None
    found = world.seeker(below=0.31)
    assert (found.name, found.soc, found.bound_for, found.is_there, found.to_soc) == ("r1", 0.3, None, False, None)
    assert found.capacity_j == pytest.approx(CAPACITY_J)
    assert not found.is_whole


@pytest.mark.parametrize("fields", [{"pose": None}, {"battery": None}, {"halted": True}], ids=str)
def test_who_tells_too_little_or_is_halted_is_not_to_charge(fields):
    world = World()
    world.change(**fields)
    assert world.seeker() is None


def test_who_is_paused_out_knows_no_charger_or_has_tasks_before_the_next_charge_is_not_sent():
    assert World().seeker(is_paused=True) is None
    world = World()
    world.out = "is halted"
    assert world.seeker() is None
    world = World()
    world.route = True
    assert world.seeker() is None
    assert world.seeker(below=math.inf) is not None
    world = World()
    world.planning.chargers.of.clear()
    assert world.seeker() is None


def test_who_goes_to_charge_of_its_own_accord_is_not_told_otherwise_on_its_way():
    world = World()
    world.change(behavior="recharge")
    found = world.seeker(below=0.0)
    assert (found.bound_for, found.is_there, found.to_soc) == (NEAR, False, CHARGED_SOC)
    world.change(pose=Pose2D(NEAR.x_m + 0.5, NEAR.y_m, 0.0))
    found = world.seeker(below=0.0)
    assert (found.bound_for, found.is_there, found.to_soc) == (NEAR, True, None)
    assert world.seeker(below=0.0, is_paused=True).to_soc == CHARGED_SOC


def test_a_robot_at_a_charger_needs_twice_what_the_tasks_that_wait_for_it_take_and_its_reserve():
    world = World(soc=0.3)
    world.change(behavior="recharge", pose=Pose2D(NEAR.x_m, NEAR.y_m, 0.0))
    assert world.seeker(below=0.0).needs_soc is None
    world.planning.route_energy_j = lambda _robot: 0.2 * CAPACITY_J
    needed = 0.3 + (2.0 * 0.2 + 0.1 - 0.3) / CHARGED_SHARE
    assert world.seeker(below=0.0).needs_soc == pytest.approx(needed)
    world.planning.route_energy_j = lambda _robot: 0.01 * CAPACITY_J
    assert world.seeker(below=0.0).needs_soc == 0.35  # below that it would be sent back at once
    world.change(pose=Pose2D(HERE.x_m, HERE.y_m, 0.0))
    assert world.seeker(below=0.0).needs_soc is None  # not there yet
