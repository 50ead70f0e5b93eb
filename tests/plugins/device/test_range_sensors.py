"""The range sensors' device: its frames, its node's silence, its bumps."""

import itertools
import math

import can
import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.plugins.device.range_sensors import NO_ECHO_M
from robrain.protocol.can.frames import codec
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.table.topics import ROBOT_EVENT
from robrain.sim.firmware.bus_line import LineFault


def device(one):
    return one.hosts[0].manager.get("range_sensors").plugin


class Node:
    """The other end of the bus."""

    def __init__(self, one):
        self.bus = one.bus()
        self.counters = {name: itertools.count() for name in ("RangeRing1", "RangeRing2", "Bumps")}

    def frame(self, name, **values):
        return codec(name).pack(next(self.counters[name]), **values)

    def ring(self, *ranges_m, number=1):
        first = 6 * (number - 1) + 1
        values = {f"range_{first + place}_m": range_m for place, range_m in enumerate(ranges_m)}
        self.bus.send(self.frame(f"RangeRing{number}", **values))

    def bump(self, contacts):
        self.bus.send(self.frame("Bumps", contacts=contacts))


def test_a_frame_is_a_measurement_in_metres_from_the_hull(stage):
    one = stage()
    one.host("range_sensors")
    Node(one).ring(0.5, 1.25, NO_ECHO_M, 2.0, 0.02, NO_ECHO_M)
    one.run(0.1)
    ring = device(one).latest()
    assert ring.ranges_m == pytest.approx((0.5, 1.25, 2.0, 2.0, 0.02, 2.0))
    assert ring.range_max_m == 2.0
    assert ring.angles_rad == pytest.approx([math.radians(60 * sensor) for sensor in range(6)])
    assert one.call("range_sensors", "latest")["mounted_m"] == 0.2


def test_more_than_six_sensors_come_in_two_frames_and_are_told_once(stage):
    one = stage()
    angles_rad = [0.1 * sensor for sensor in range(8)]
    one.host("range_sensors", range_sensors={"angles_rad": angles_rad})
    node = Node(one)
    node.ring(*[0.1] * 6)
    one.run(0.1)
    assert device(one).latest() is None
    node.ring(0.7, 0.8, *[NO_ECHO_M] * 4, number=2)
    one.run(0.1)
    assert device(one).latest().ranges_m == pytest.approx((*[0.1] * 6, 0.7, 0.8))


def test_corrupt_frames_are_counted_and_not_believed_and_gaps_are_lost_frames(stage):
    one = stage()
    one.host("range_sensors")
    node = Node(one)
    node.ring(*[0.5] * 6)
    corrupt = node.frame("RangeRing1", **{f"range_{sensor}_m": 0.1 for sensor in range(1, 7)})
    corrupt.data[2] ^= 0x04
    node.bus.send(corrupt)
    node.ring(*[0.6] * 6)
    one.run(0.1)
    assert device(one).latest().ranges_m == pytest.approx([0.6] * 6)
    assert one.call("range_sensors", "counters") == {"believed": 2, "rejected": 1, "lost": 1}


def test_frames_that_are_none_of_its_business_are_passed_over(stage):
    one = stage()
    one.host("range_sensors")
    bus = one.bus()
    bus.send(codec("WheelEncoders").pack(1, wheel_1_ticks=1, wheel_2_ticks=2, wheel_3_ticks=3))
    bus.send(can.Message(arbitration_id=0x280, data=bytes(8), is_extended_id=True))
    bus.send(can.Message(arbitration_id=0x280, is_extended_id=False, is_remote_frame=True, dlc=8))
    one.run(0.1)
    assert one.call("range_sensors", "counters") == {"believed": 0, "rejected": 0, "lost": 0}


def test_each_change_of_the_bump_contacts_is_told_the_team_too(stage):
    one = stage()
    told = one.inbox(ROBOT_EVENT, robot="r1", plugin="range_sensors")
    one.host("range_sensors")
    node = Node(one)
    for contacts in (0b00000101, 0b00000101, 0):
        node.bump(contacts)
        one.run(0.1)
    assert [message.message.value["directions_rad"] for message in told.drain()] == [
        [0.0, pytest.approx(math.pi / 2)],
        [],
    ]


def test_a_robot_without_the_node_has_no_ranges_and_no_fault(stage):
    one = stage()
    one.host("range_sensors")
    one.run(10.0)
    assert one.infos()["range_sensors"].state == "active"
    assert one.call("range_sensors", "latest") is None


def test_a_node_that_falls_silent_is_a_fault_that_the_team_is_told_of(stage):
    one = stage()
    told = one.inbox(ROBOT_EVENT, robot="r1", plugin="range_sensors")
    one.host("range_sensors")
    node = Node(one)
    node.ring(*[0.5] * 6)
    one.run(1.1)
    assert one.infos()["range_sensors"].state == "faulted"
    (message,) = told.drain()
    assert "the range sensors have been silent for 1.0 s" in message.message.value
    one.run(0.6)
    node.ring(*[0.7] * 6)
    one.run(0.1)
    assert device(one).latest().ranges_m == pytest.approx([0.7] * 6)


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


def test_a_cut_bus_silences_the_range_sensors_too(stage, room):
    one = stage(room(4.0, 4.0), r1=Pose2D(1.0, 2.0, 0.0))
    one.host("range_sensors")
    one.run(0.5)
    one.arena.break_can("r1", LineFault.CUT)
    one.run(1.1)
    assert one.infos()["range_sensors"].state == "faulted"


@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ({"angles_rad": []}, "expected 1 to 12 angles_rad, got 0"),
        ({"angles_rad": [0.0] * 13}, "expected 1 to 12 angles_rad, got 13"),
        ({"range_max_m": 0.0}, "expected range_max_m > 0"),
        ({"silent_s": -1.0}, "expected silent_s > 0"),
        ({"mounted_m": 0.0}, "expected mounted_m > 0"),
    ],
)
def test_a_ring_without_sense_is_refused(stage, parameters, why):
    one = stage()
    one.host("range_sensors", range_sensors=parameters)
    assert why in one.infos()["range_sensors"].why
