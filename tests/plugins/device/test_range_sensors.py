"""The range sensors' device: its frames, its node's silence, its bumps."""

import itertools
import math

import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.can.frames import codec
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.sim.firmware.bus_line import LineFault


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


def test_a_cut_bus_silences_the_range_sensors_too(stage, room):
    one = stage(room(4.0, 4.0), r1=Pose2D(1.0, 2.0, 0.0))
    one.host("range_sensors")
    one.run(0.5)
    one.arena.robot("r1").bus.break_down(LineFault.CUT)
    one.run(1.1)
    assert one.infos()["range_sensors"].state == "faulted"
