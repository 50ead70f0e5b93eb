from types import SimpleNamespace

import numpy as np

from robrain.protocol.clock import VirtualClock
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.firmware.battery import BatterySpec
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.robot.robot_hardware import ArenaRobot
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.scenarios.scenario_file import parse_scenario
from robrain.sim.world.arena import Arena
from robrain.sim.world.chargers import Chargers, ChargerSpec
from robrain.sim.world.world import TICK_S, World

DOCK = ChargerSpec(place_m=(1.0, 1.0), power_w=30.0, reach_m=0.2)


def body(x_m: float, y_m: float, *, moving: bool = False) -> SimpleNamespace:
    return SimpleNamespace(x_m=x_m, y_m=y_m, forward_m=0.01 if moving else 0.0, left_m=0.0)


def room() -> FloorPlan:
    occupied = np.zeros((80, 80), np.bool_)
    occupied[[0, -1], :] = occupied[:, [0, -1]] = True
    return FloorPlan(occupied, 0.05, 0.0, 0.0, "room")


def test_a_robot_that_stands_within_reach_is_fed_and_one_that_drives_by_or_stands_beside_is_not():
    chargers = Chargers([DOCK], TICK_S)
    assert chargers.supplies_w([body(1.1, 1.1), body(3.0, 3.0)]) == [30.0, 0.0]
    assert chargers.docked == [0]

    assert chargers.supplies_w([body(1.0, 1.0, moving=True), body(1.3, 1.0)]) == [0.0, 0.0]


def test_a_dock_feeds_one_robot_until_that_one_leaves():
    chargers = Chargers([DOCK], TICK_S)
    first, second = body(1.15, 1.0), body(1.0, 1.0)
    chargers.supplies_w([body(3.0, 3.0), second])
    assert chargers.supplies_w([first, second]) == [0.0, 30.0]
    assert chargers.supplies_w([first, body(2.0, 2.0)]) == [30.0, 0.0]


def test_one_robot_is_not_fed_by_two_docks():
    other = ChargerSpec(place_m=(1.1, 1.0), power_w=50.0)
    chargers = Chargers([DOCK, other], TICK_S)
    assert chargers.supplies_w([body(1.05, 1.0), body(1.1, 1.05)]) == [30.0, 50.0]


def test_a_robot_of_the_arena_is_charged_at_a_dock():
    session = open_lockstep_session()
    clock = VirtualClock()
    wire = Endpoint(session, "test", clock, Drive.LOCKSTEP)
    battery = BatterySpec(soc_at_start=0.5)
    robots = [
        ArenaRobot(name=f"r{number}", start=Pose2D(x_m, 1.0, 0.0), battery=battery)
        for number, x_m in enumerate((1.0, 2.0), 1)
    ]
    arena = Arena(World(room(), robots, [], 1, chargers=(DOCK,)), wire)
    for tick in range(1, 101):
        clock.advance_to(tick * 20_000_000)
        arena.step()
    docked, other = (robot.battery for robot in arena._robots)
    assert docked.soc > 0.5 > other.soc
    assert docked.current_a < 0 < other.current_a
    arena.close()
    wire.close()
    session.close()


def test_a_scenario_file_says_where_chargers_are_and_robots_are_told():
    tables = parse_scenario(
        '[scenario]\nname = "x"\n[floor]\nsize_m = [6.0, 6.0]\n'
        "[[chargers]]\nplace_m = [1.0, 2.0]\npower_w = 50.0\n[[chargers]]\nplace_m = [4.0, 4.0]\nyaw_rad = 1.5\n",
        "x.toml",
    )
    scenario = Scenario(name="x", floor=tables.floor, robots=2, chargers=tables.chargers)
    world = scenario.world()
    assert [charger.power_w for charger in world.chargers] == [50.0, 40.0]
    assert world.robot_file(world.robots[0]).parameters["home"] == {
        "chargers": [{"x_m": 1.0, "y_m": 2.0}, {"x_m": 4.0, "y_m": 4.0, "yaw_rad": 1.5}]
    }
