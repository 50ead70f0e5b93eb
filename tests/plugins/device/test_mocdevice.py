import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.sim.firmware.bus_line import LineFault

BASE = OmniBase()
WHEELS = ("wheel_1", "wheel_2", "wheel_3")


def device(host):
    return host.manager.get("mocdevice").plugin


def test_a_commanded_velocity_is_on_the_bus_as_wheel_speeds(stage, frames):
    one = stage()
    host = one.host("mocdevice")
    bus = one.bus()
    twist = Twist2D(0.3, -0.1, 0.7)
    device(host).drive(twist)
    (command,) = frames(bus, "WheelCommand")
    speeds = [command[f"{wheel}_rad_s"] for wheel in WHEELS]
    assert speeds == pytest.approx(BASE.wheel_speeds_rad_s(twist), abs=1e-3)
    device(host).drive(twist)
    assert frames(bus, "WheelCommand")[0]["counter"] == command["counter"] + 1


def test_a_robot_that_is_shut_down_stops_its_wheels(stage, frames):
    one = stage()
    host = one.host("mocdevice")
    bus = one.bus()
    one.hosts.remove(host)
    host.close()
    assert len(frames(bus, "Stop")) == 1


def test_an_emergency_halt_stops_the_wheels_and_refuses_calls_until_resumed(stage, frames):
    one = stage()
    one.host("mocdevice")
    bus = one.bus()
    states = one.inbox(ROBOT_STATE)
    one.halt()
    one.run(0.2)
    assert len(frames(bus, "Stop")) == 1
    assert states.drain()[-1].message.halted
    with pytest.raises(CallError) as refused:
        one.call("mocdevice", "counters")
    assert refused.value.code is ErrorCode.HALTED
    one.halt(halted=False)
    one.run(0.2)
    assert one.call("mocdevice", "counters")["believed"] == 0
    assert not states.drain()[-1].message.halted


@pytest.mark.parametrize(("interface", "channel"), [("socketcan", "nonexistent0"), ("no_such_interface", "can0")])
def test_a_robot_without_its_bus_goes_on_without_that_branch_and_says_why(stage, interface, channel):
    one = stage()
    states = one.inbox(ROBOT_STATE)
    one.host("explore", "teammates", mocdevice={"interface": interface, "channel": channel})
    one.run(1.0)
    infos = one.infos()
    active = {name for name, info in infos.items() if info.state == "active"}
    assert {"range_sensors", "scan", "teammates"} <= active
    for name in ("mocdevice", "driver", "localisation", "mapper", "explore"):
        assert infos[name].state == "faulted"
        assert f"no CAN bus at {interface}:{channel}" in infos[name].why
    assert infos["mocdevice"].why.startswith("hardware absent")
    assert infos["driver"].why.startswith("requires mocdevice, which is left out")
    assert len(states.drain()) >= 10
    assert one.call("teammates", "others") == []


START = Pose2D(1.0, 2.0, 0.0)


@pytest.fixture
def robot(stage, room):
    """A robot that drives through a room of 6 × 4 m, and what its motor controller's device tells the team."""
    one = stage(room(6.0, 4.0), r1=START)
    one.told = one.inbox(ROBOT_EVENT, robot="r1", plugin="mocdevice")
    one.host("localisation", range_sensors={"silent_s": 60.0})  # they fall silent with the same bus
    one.run(0.4)
    one.call("driver", "drive", 4.0)
    one.run(1.5)
    assert one.call("driver", "velocity")["forward_m_s"] > 0.4
    return one


def conditions(one):
    return [(each.message.value["ok"], each.message.value["why"]) for each in one.told.drain()]


def state(one, plugin="mocdevice"):
    info = one.infos()[plugin]
    return info.state, info.why


def test_a_cut_bus_is_named_and_told_within_half_a_second_and_the_robot_stands(robot):
    robot.arena.robot("r1").bus.break_down(LineFault.CUT)
    took_s = robot.run_until(lambda: state(robot)[0] == "faulted", 0.5)
    assert took_s <= 0.5
    ((ok, why),) = conditions(robot)
    assert not ok
    assert "no encoder frame for 0.4" in why
    assert "the CAN bus zenoh:can0 is cut" in why
    assert why in state(robot)[1]
    robot.run(0.02)
    assert state(robot, "driver")[1].startswith("requires mocdevice, which is faulted")
    robot.run(0.3)
    place = robot.truth().pose
    robot.run(3.0)
    assert robot.truth().pose == place
    assert robot.truth().collisions == 0


def test_a_bus_that_comes_back_is_used_again_and_the_odometry_goes_on(robot):
    robot.arena.robot("r1").bus.break_down(LineFault.CUT)
    robot.run(4.0)
    robot.arena.robot("r1").bus.break_down(LineFault.NONE)
    robot.run_until(lambda: conditions(robot)[-1:] == [(True, "the motor controller speaks again")], 5.0)
    robot.run(0.2)
    assert state(robot)[0] == state(robot, "driver")[0] == "active"
    # Where it rolled to after the cut is in the wheels' counts.
    pose = robot.call("driver", "pose")
    assert pose["x_m"] == pytest.approx(robot.truth().pose.x_m - START.x_m, abs=0.01)
    assert pose["y_m"] == pytest.approx(robot.truth().pose.y_m - START.y_m, abs=0.01)
    x_m = robot.truth().pose.x_m
    robot.call("driver", "drive", 0.5)
    robot.run(3.0)
    assert robot.truth().pose.x_m == pytest.approx(x_m + 0.5, abs=0.05)
