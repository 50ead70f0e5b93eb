"""Battery manager and range sensors, frame by frame, on a fake bus."""

import itertools
import math

import can
import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.plugins.device.bm2.bm2 import Bm2
from robrain.plugins.device.bm2.interface import BatteryMeasurement
from robrain.plugins.device.range_sensors import Bump, RangeCounters, RangeSensorFault, RangeSensorsDevice
from robrain.protocol.can.frames import codec
from robrain.protocol.model.geometry import Pose2D, Twist2D
from tests.plugins.device.bare_device import BareDevice


@pytest.fixture
def gauge():
    one = BareDevice(Bm2, interface="slcan", channel="tty", options={"bitrate": 500})
    one.it.activate()
    return one


def measure(gauge, current_a, voltage_v=15.0, after_s=0.0):
    gauge.wait(after_s)
    gauge.hear("BatteryStatus", 1, voltage_v=voltage_v, current_a=current_a, temperature_c=21.5)
    gauge.step()
    return gauge.it.latest()


def test_manager_is_heard_by_its_own_frames_only(gauge):
    filters = [{"can_id": codec("BatteryStatus").arbitration_id, "can_mask": 0x7FF, "extended": False}]
    assert gauge.opened == [("slcan", "tty", {"bitrate": 500, "can_filters": filters})]


def test_first_measurement_begins_the_count(gauge):
    assert gauge.it.latest() is None
    now_ns = gauge.clock.now_ns()
    assert measure(gauge, -1.25) == BatteryMeasurement(now_ns, 15.0, -1.25, 21.5, 0.0, 0.0, now_ns)


def test_charge_and_energy_are_those_of_the_time_since_the_frame_before(gauge):
    begun_ns = measure(gauge, 1.0).stamp_ns
    measure(gauge, 2.0, 14.0, after_s=0.5)
    last = measure(gauge, -0.5, 16.0, after_s=0.25)
    assert last.charge_c == pytest.approx(2.0 * 0.5 - 0.5 * 0.25)
    assert last.energy_j == pytest.approx(2.0 * 14.0 * 0.5 - 0.5 * 16.0 * 0.25)
    assert last.counted_from_ns == begun_ns


@pytest.mark.parametrize(("after_s", "counted_s"), [(Bm2.gap_s, Bm2.gap_s), (Bm2.gap_s + 0.001, 0.0), (0.0, 0.0)])
def test_gap_is_not_counted(gauge, after_s, counted_s):
    measure(gauge, 1.0)
    assert measure(gauge, 3.0, after_s=after_s).charge_c == pytest.approx(3.0 * counted_s)


def test_clock_of_the_frames_that_goes_back_draws_nothing(gauge):
    measure(gauge, 1.0)
    frame = gauge.hear("BatteryStatus", 2, voltage_v=15.0, current_a=1.0, temperature_c=21.5)
    frame.timestamp -= 1.0
    gauge.step()
    assert gauge.it.latest().charge_c == 0.0


def test_corrupt_measurements_are_counted_and_those_after_them_taken(gauge):
    gauge.hear("BatteryStatus", 1, voltage_v=15.0, current_a=1.0, temperature_c=20.0).data[-1] ^= 1
    gauge.hear("BatteryStatus", 2, voltage_v=14.0, current_a=1.0, temperature_c=20.0)
    gauge.hear("BatteryStatus", 3, voltage_v=13.0, current_a=1.0, temperature_c=20.0).data[0] ^= 1
    gauge.step()
    assert (gauge.it.rejected(), gauge.it.latest().voltage_v) == (2, 14.0)


@pytest.mark.parametrize("device_class", [Bm2, RangeSensorsDevice])
def test_deactivated_device_leaves_its_bus_and_can_be_asked_again(device_class):
    one = BareDevice(device_class)
    one.step()
    assert one.it.latest() is None
    one.it.activate()
    one.it.deactivate()
    assert not one.bus.is_open
    one.it.deactivate()
    one.step(5.0)
    one.it.activate()
    assert len(one.buses) == 2


# -- range sensors ----------------------------------------------------------------------------------------------


@pytest.fixture
def ring():
    one = BareDevice(RangeSensorsDevice)
    one.it.activate()
    return one


def echo(one, counter, *ranges_m, frame=1):
    first = 6 * (frame - 1) + 1
    return one.hear(f"RangeRing{frame}", counter, **{f"range_{first + n}_m": each for n, each in enumerate(ranges_m)})


def test_node_is_heard_by_its_own_frames_only(ring):
    filters = [{"can_id": 0x280, "can_mask": 0x7FC, "extended": False}]
    assert ring.opened == [("zenoh", "can0", {"can_filters": filters})]


def test_ring_is_told_with_its_time_and_what_is_too_far_is_nothing(ring):
    told = ring.told(ring.it.measured)
    echo(ring, 1, 0.5, 1.99, 2.0, 2.01, 2.55, 0.0)
    ring.step()
    assert told == [ring.it.latest()]
    assert told[0].ranges_m == pytest.approx((0.5, 1.99, 2.0, 2.0, 2.0, 0.0))
    assert (told[0].stamp_ns, told[0].range_max_m, told[0].mounted_m) == (ring.clock.now_ns(), 2.0, 0.2)


def test_seven_sensors_are_told_once_both_frames_have_come():
    one = BareDevice(RangeSensorsDevice, angles_rad=tuple(0.1 * n for n in range(7)))
    one.it.activate()
    told = one.told(one.it.measured)
    echo(one, 1, *[0.4] * 6)
    one.step()
    assert told == []
    echo(one, 1, 0.7, *[0.1] * 5, frame=2)
    one.step()
    assert [each.ranges_m for each in told] == [pytest.approx((*[0.4] * 6, 0.7))]


def test_each_change_of_the_contacts_is_told_once(ring):
    told = ring.told(ring.it.bumped)
    for counter, contacts in enumerate((0b1, 0b1, 0b10001, 0, 0)):
        ring.hear("Bumps", counter, contacts=contacts)
    ring.step()
    now_ns = ring.clock.now_ns()
    assert told == [Bump(now_ns, (0.0,)), Bump(now_ns, (0.0, math.pi)), Bump(now_ns, ())]
    assert ring.it.pressed_rad() == ()


def test_frames_are_counted_as_believed_rejected_and_lost(ring):
    echo(ring, 1, *[1.0] * 6)
    echo(ring, 4, *[1.0] * 6)
    echo(ring, 5, *[0.5] * 6).data[-1] ^= 1
    ring.hear("Bumps", 1, contacts=1)
    ring.hear("Bumps", 2, contacts=3).data[-1] ^= 1
    remote = can.Message(arbitration_id=codec("Bumps").arbitration_id, is_remote_frame=True, is_extended_id=False)
    wrong = can.Message(arbitration_id=codec("Bumps").arbitration_id, is_error_frame=True, is_extended_id=False)
    ring.bus.arrived.extend((remote, wrong))
    ring.step()
    assert ring.it.counters() == RangeCounters(believed=3, rejected=2, lost=2)
    assert ring.it.latest().ranges_m == pytest.approx([1.0] * 6)
    assert ring.it.pressed_rad() == (0.0,)


def test_node_that_has_spoken_may_be_silent_for_just_so_long(ring):
    silent = ring.told(ring.it.silent)
    ring.step(60.0)
    ring.hear("Bumps", 1, contacts=0)
    ring.step()
    ring.step(0.5)
    ring.step(0.5)
    with pytest.raises(RangeSensorFault, match=r"silent for 1\.0 s"):
        ring.step(0.001)
    assert ["silent for 1.0 s" in each for each in silent] == [True]


def test_corrupt_frame_is_no_sign_of_life(ring):
    ring.hear("Bumps", 1, contacts=0)
    ring.step()
    ring.hear("Bumps", 2, contacts=0).data[-1] ^= 1
    ring.step(0.5)
    ring.step(0.5)
    with pytest.raises(RangeSensorFault):
        ring.step(0.1)


def test_node_is_not_silent_because_the_process_stood_still(ring):
    ring.hear("Bumps", 1, contacts=0)
    ring.step()
    ring.step(20.0)
    ring.hear("Bumps", 2, contacts=0)
    ring.step(0.01)
    ring.step(0.5)


@pytest.mark.parametrize("error", [can.CanOperationError("broken"), OSError("gone")])
def test_bus_that_cannot_be_read_is_a_fault_of_the_range_sensors_and_told(ring, error):
    silent = ring.told(ring.it.silent)
    ring.bus.fails = error
    with pytest.raises(RangeSensorFault, match="the CAN bus cannot be read"):
        ring.step()
    assert len(silent) == 1


@pytest.mark.parametrize("count", [0, 13])
def test_ring_has_one_to_twelve_sensors(count):
    with pytest.raises(ValueError, match="expected angles_rad of length at"):
        RangeSensorsDevice.Parameters(angles_rad=(0.0,) * count)
    for possible in (1, 12):
        RangeSensorsDevice.Parameters(angles_rad=(0.0,) * possible)


def device(one):
    return one.plugin("range_sensors")


def test_in_the_arena_ranges_are_what_lies_around_the_robot(stage, room):
    one = stage(room(4.0, 4.0), r1=Pose2D(1.0, 2.0, 0.0))
    one.host("range_sensors")
    rings = []
    one.run(2.0, lambda: rings.append(device(one).latest()))
    backward_m = [ring.ranges_m[3] for ring in rings if ring is not None and ring.ranges_m[3] < 2.0]
    assert sum(backward_m) / len(backward_m) == pytest.approx(0.7, abs=0.02)  # the wall's inside at 0.1 m
    assert max(backward_m) - min(backward_m) > 0.01  # noise
    assert all(ring.ranges_m[0] == 2.0 for ring in rings if ring is not None)  # 2.7 m to the wall ahead
    assert one.call("range_sensors", "counters")["lost"] == 0


def test_in_the_arena_a_push_against_a_wall_presses_the_contact_on_that_side(stage, room):
    one = stage(room(4.0, 4.0), r1=Pose2D(1.0, 3.4, math.pi / 4))
    one.host("range_sensors")
    bus = one.bus()
    wheels = dict(zip(("wheel_1_rad_s", "wheel_2_rad_s", "wheel_3_rad_s"), push(Twist2D(0.2, 0.2)), strict=True))
    count = itertools.count()
    one.run(2.0, lambda: bus.send(codec("WheelCommand").pack(next(count), **wheels)))
    assert one.truth().collisions == 1
    assert one.call("range_sensors", "pressed_rad") == pytest.approx([math.pi / 4])  # north, as it looks north-east
    wheels = dict(zip(wheels, push(Twist2D(-0.2, -0.2)), strict=True))
    one.run(0.5, lambda: bus.send(codec("WheelCommand").pack(next(count), **wheels)))
    assert one.call("range_sensors", "pressed_rad") == []


def push(twist):
    return OmniBase().wheel_speeds_rad_s(twist)
