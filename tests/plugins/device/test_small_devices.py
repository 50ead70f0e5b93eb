"""Battery manager and range sensors, frame by frame, on a fake bus."""

import math

import can
import pytest

from robrain.plugins.device.bm2.bm2 import Bm2
from robrain.plugins.device.range_sensors import Bump, RangeCounters, RangeSensorFault, RangeSensorsDevice
from robrain.protocol.can.frames import codec
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


def test_ring_is_told_with_its_time_and_what_is_too_far_is_nothing(ring):
    told = ring.told(ring.it.measured)
    echo(ring, 1, 0.5, 1.99, 2.0, 2.01, 2.55, 0.0)
    ring.step()
    assert told == [ring.it.latest()]
    assert told[0].ranges_m == pytest.approx((0.5, 1.99, 2.0, 2.0, 2.0, 0.0))
    assert (told[0].stamp_ns, told[0].range_max_m, told[0].mounted_m) == (ring.clock.now_ns(), 2.0, 0.2)


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


@pytest.mark.parametrize("error", [can.CanOperationError("broken"), OSError("gone")])
def test_bus_that_cannot_be_read_is_a_fault_of_the_range_sensors_and_told(ring, error):
    silent = ring.told(ring.it.silent)
    ring.bus.fails = error
    with pytest.raises(RangeSensorFault, match="the CAN bus cannot be read"):
        ring.step()
    assert len(silent) == 1
