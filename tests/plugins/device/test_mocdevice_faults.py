"""What goes wrong on the bus: named, told, survived."""

import pytest

from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.table.topics import ROBOT_EVENT
from robrain.sim.firmware.bus_line import LineFault

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


def test_a_shorted_bus_is_bus_off_at_once(robot):
    robot.arena.robot("r1").bus.break_down(LineFault.SHORTED)
    robot.run(0.04)
    assert state(robot)[0] == "faulted"
    assert conditions(robot) == [(False, "the computer's CAN controller is bus off")]
    robot.run(1.0)
    robot.arena.robot("r1").bus.break_down(LineFault.NONE)
    robot.run(4.0)
    assert state(robot)[0] == state(robot, "driver")[0] == "active"
    assert robot.call("driver", "controller_status")["transmit_errors"] == 0


def test_a_power_stage_that_has_failed_is_a_fault_until_it_is_well_again(robot):
    robot.arena.robot("r1").controller.has_failed = True
    robot.run(0.1)
    assert state(robot)[0] == "faulted"
    assert conditions(robot)[0] == (False, "the motor controller reports that its power stage has failed")
    robot.run(6.0)
    assert state(robot)[0] == "faulted"
    place = robot.truth().pose
    robot.arena.robot("r1").controller.has_failed = False
    robot.run(8.0)
    assert state(robot)[0] == state(robot, "driver")[0] == "active"
    assert robot.call("driver", "controller_status")["state"] == 1  # it waits for commands
    assert robot.truth().pose == place
    robot.call("driver", "drive", 0.3)
    robot.run(3.0)
    assert robot.truth().pose.x_m == pytest.approx(place.x_m + 0.3, abs=0.05)


def test_no_command_is_given_on_a_bus_that_has_not_spoken_again(robot, frames):
    robot.arena.robot("r1").bus.break_down(LineFault.CUT)
    robot.run_until(lambda: state(robot)[0] == "faulted", 0.5)
    robot.run(0.1)
    bus = robot.bus()
    robot.run_until(lambda: state(robot, "driver")[0] == "active", 2.0)
    robot.call("driver", "drive", 1.0)
    robot.run(0.2)
    assert robot.call("driver", "motion") == Motion.BLOCKED
    assert robot.call("driver", "blocked_why") == "no data from the wheel encoders"
    assert frames(bus, "WheelCommand") == []
