"""What goes wrong on the bus: named, told, survived."""

import can
import pytest

from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.can.bus_state import BusState, error_frame
from robrain.protocol.can.frames import codec
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.topics import ROBOT_EVENT
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
    robot.arena.break_can("r1", LineFault.CUT)
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
    robot.arena.break_can("r1", LineFault.CUT)
    robot.run(4.0)
    robot.arena.break_can("r1", LineFault.NONE)
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


def test_while_the_bus_is_cut_the_device_tries_again_with_growing_pauses(robot):
    robot.arena.break_can("r1", LineFault.CUT)
    robot.run(10.0)
    # Each try takes 0.42 s; between them lie 0.5, 1, 2 and 4 s.
    assert len(conditions(robot)) == 5
    assert robot.infos()["mocdevice"].restarts == 4


def test_a_shorted_bus_is_bus_off_at_once(robot):
    robot.arena.break_can("r1", LineFault.SHORTED)
    robot.run(0.04)
    assert state(robot)[0] == "faulted"
    assert conditions(robot) == [(False, "the computer's CAN controller is bus off")]
    robot.run(1.0)
    robot.arena.break_can("r1", LineFault.NONE)
    robot.run(4.0)
    assert state(robot)[0] == state(robot, "driver")[0] == "active"
    assert robot.call("driver", "controller_status")["transmit_errors"] == 0


def test_after_a_cut_the_controller_reports_that_it_was_error_passive(robot):
    robot.arena.break_can("r1", LineFault.CUT)
    robot.run(0.2)  # too short for a fault
    robot.arena.break_can("r1", LineFault.NONE)
    robot.run(0.3)
    assert state(robot)[0] == "active"
    assert robot.call("driver", "controller_status")["bus_state"] == BusState.PASSIVE
    robot.run(5.0)
    status = robot.call("driver", "controller_status")
    assert (status["bus_state"], status["transmit_errors"]) == (BusState.ACTIVE, 0)


def test_frames_that_a_short_cut_swallowed_are_counted_as_lost(robot):
    robot.arena.break_can("r1", LineFault.CUT)
    robot.run(0.1)
    robot.arena.break_can("r1", LineFault.NONE)
    robot.run(0.5)
    assert robot.call("driver", "bus_counters")["lost"] == 5
    assert robot.call("driver", "controller_status")["lost_commands"] in (1, 2)
    pose = robot.call("driver", "pose")
    assert pose["x_m"] == pytest.approx(robot.truth().pose.x_m - START.x_m, abs=0.01)


def test_a_power_stage_that_has_failed_is_a_fault_until_it_is_well_again(robot):
    robot.arena.fail_motors("r1")
    robot.run(0.1)
    assert state(robot)[0] == "faulted"
    assert conditions(robot)[0] == (False, "the motor controller reports that its power stage has failed")
    robot.run(6.0)
    assert state(robot)[0] == "faulted"
    place = robot.truth().pose
    robot.arena.fail_motors("r1", failed=False)
    robot.run(8.0)
    assert state(robot)[0] == state(robot, "driver")[0] == "active"
    assert robot.call("driver", "controller_status")["state"] == 1  # it waits for commands
    assert robot.truth().pose == place
    robot.call("driver", "drive", 0.3)
    robot.run(3.0)
    assert robot.truth().pose.x_m == pytest.approx(place.x_m + 0.3, abs=0.05)


def test_no_command_is_given_on_a_bus_that_has_not_spoken_again(robot, frames):
    robot.arena.break_can("r1", LineFault.CUT)
    robot.run_until(lambda: state(robot)[0] == "faulted", 0.5)
    robot.run(0.1)
    bus = robot.bus()
    robot.run_until(lambda: state(robot, "driver")[0] == "active", 2.0)
    robot.call("driver", "drive", 1.0)
    robot.run(0.2)
    assert robot.call("driver", "motion") == Motion.BLOCKED
    assert robot.call("driver", "blocked_why") == "no data from the wheel encoders"
    assert frames(bus, "WheelCommand") == []


def test_an_error_passive_bus_is_counted_and_driven_on(robot):
    robot.bus().send(error_frame(BusState.PASSIVE))
    robot.run(0.1)
    assert state(robot)[0] == "active"
    assert robot.call("driver", "bus_counters")["errors"] == 1


def test_commands_of_another_are_foreign_and_own_echoes_are_not(robot, frames):
    other, before = robot.bus(), robot.call("driver", "bus_counters")["foreign"]
    assert before == 0
    listener = robot.bus()
    robot.run(0.2)
    echo = next(frame for frame in iter(lambda: listener.recv(timeout=0), None) if frame.arbitration_id == 0x100)
    other.send(echo)
    robot.run(0.02)
    assert robot.call("driver", "bus_counters")["foreign"] == 0
    other.send(codec("WheelCommand").pack(7, wheel_1_rad_s=1.0, wheel_2_rad_s=2.0, wheel_3_rad_s=3.0))
    robot.run(0.02)
    assert robot.call("driver", "bus_counters")["foreign"] == 1


def test_counts_that_wheels_cannot_have_made_move_nothing(stage):
    one = stage()
    host = one.host("mocdevice")
    controller = one.bus()
    for counter, ticks in enumerate((0, 100, 20_000, 20_100)):
        controller.send(codec("WheelEncoders").pack(counter, **{f"wheel_{wheel}_ticks": ticks for wheel in (1, 2, 3)}))
    one.run(0.02)
    counters = one.call("mocdevice", "counters")
    assert (counters["believed"], counters["rejected"]) == (3, 1)
    device = host.manager.get("mocdevice").plugin
    base = device.parameters.base
    assert device.pose().yaw_rad == pytest.approx(base.twist(*[200 * base.rad_per_tick] * 3).yaw_rad_s)


def test_a_controller_that_has_never_spoken_is_no_fault(stage):
    one = stage()
    one.host("driver")
    one.run(5.0)
    assert state(one)[0] == "active"
    assert one.call("driver", "controller_status") is None


@pytest.mark.parametrize("error", [can.CanOperationError("network is down"), OSError(100, "network is down")])
@pytest.mark.parametrize("which", ["send_data", "take_frames"])
def test_a_bus_that_fails_in_use_is_the_fault_of_the_device_not_of_its_caller(robot, monkeypatch, which, error):
    def fail(*_args, **_kwargs):
        raise error

    monkeypatch.setattr(robot.hosts[0].manager.get("mocdevice").plugin._link._bus, which, fail)
    robot.run(0.1)
    ((ok, why),) = conditions(robot)
    assert not ok
    assert "network is down" in why
    monkeypatch.undo()
    robot.run(1.0)
    assert state(robot)[0] == state(robot, "driver")[0] == "active"


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"no_such_option": 1}, "no CAN bus at virtual:can0"),  # the interface does not know it
        ("fast", "expected `object`|Expected `object`"),  # no table
    ],
)
def test_options_that_the_interface_does_not_take_are_refused_with_the_reason(stage, options, why):
    one = stage()
    if isinstance(options, dict):
        one.host("mocdevice", mocdevice={"interface": "udp_multicast", "channel": "nowhere", "options": options})
        assert "no CAN bus at udp_multicast:nowhere" in one.infos()["mocdevice"].why
    else:
        one.host("mocdevice", mocdevice={"options": options})
        assert "options" in one.infos()["mocdevice"].why
