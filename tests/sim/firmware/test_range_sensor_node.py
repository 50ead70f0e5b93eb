import math

import numpy as np
import pytest

from robrain.plugins.device.range_sensors import NO_ECHO_M
from robrain.protocol.can.frames import codec
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.sim.firmware.range_sensors import RangeSensors, RangeSensorSpec

TICK_S = 0.02
RADIUS_M = 0.2


class Bus:
    """Takes what the node sends."""

    def __init__(self):
        self.frames = []

    def send(self, frame):
        self.frames.append(frame)

    def taken(self, name):
        frames, self.frames = self.frames, []
        wanted = codec(name)
        return [wanted.unpack(frame) for frame in frames if frame.arbitration_id == wanted.arbitration_id]


def node(spec=None, seed=1):
    walls = np.zeros((80, 80), np.bool_)
    walls[:, 60:] = True  # from x = 3.0 m on
    bus = Bus()
    spec = spec if spec is not None else RangeSensorSpec(noise_m=0.0, dropout=0.0)
    geometry = GridGeometry(0.05, 0.0, 0.0, 80, 80)
    return RangeSensors(bus, spec, RADIUS_M, walls, geometry, np.random.default_rng(seed), TICK_S), bus


NOBODY = np.empty((0, 3))
HERE = Pose2D(2.0, 2.0, 0.0)


def ranges(bus, name="RangeRing1", first=1):
    (signals,) = bus.taken(name)
    return [signals[f"range_{sensor}_m"] for sensor in range(first, first + 6)]


def test_a_sensor_measures_from_the_hull():
    ring, bus = node()
    ring.measure(HERE, NOBODY)
    measured = ranges(bus)
    assert measured[0] == pytest.approx(0.8, abs=0.01)
    # 60° aside the cone's inner edge is the nearest: 1 m over cos 47.5°.
    assert measured[1] == measured[5] == pytest.approx(1.0 / math.cos(math.radians(47.5)) - 0.2, abs=0.01)
    # Behind is the arena's edge, 2 m from the robot, and 2 m over cos 17.5° for those aside.
    assert measured[2:5] == pytest.approx([1.9, 1.8, 1.9], abs=0.01)


def test_a_cone_hears_what_lies_beside_its_axis():
    ring, bus = node()
    beside = np.array([[2.0 + math.cos(math.radians(12)), 2.0 + math.sin(math.radians(12)), 0.05]])
    ring.measure(HERE, beside)
    assert ranges(bus)[0] == pytest.approx(0.75, abs=0.02)


def test_noise_and_dropouts_are_of_the_size_that_is_asked_for():
    ring, bus = node(RangeSensorSpec(noise_m=0.02, dropout=0.1))
    heard = []
    for _ in range(1000):
        ring.measure(HERE, NOBODY)
        heard.append(ranges(bus)[0])
    echoes = np.array([range_m for range_m in heard if range_m < NO_ECHO_M])
    assert echoes.mean() == pytest.approx(0.8, abs=0.005)
    assert echoes.std() == pytest.approx(0.02, rel=0.15)
    assert 1.0 - echoes.size / len(heard) == pytest.approx(0.1, abs=0.03)


def test_more_than_six_sensors_take_two_frames():
    ring, bus = node(RangeSensorSpec(angles_rad=tuple(np.linspace(0, 3, 8).tolist()), noise_m=0.0, dropout=0.0))
    ring.measure(HERE, NOBODY)
    assert [frame.arbitration_id for frame in bus.frames] == [0x280, 0x281]
    ranges(bus, "RangeRing1")
    ring.measure(HERE, NOBODY)
    second = ranges(bus, "RangeRing2", 7)
    assert second[2:] == pytest.approx([NO_ECHO_M] * 4)


def test_a_touch_is_told_at_once_and_again_every_second():
    ring, bus = node()
    for tick in range(1, 120):
        ring.feel(tick, 0.0, [0.1] if 20 <= tick < 25 else [])
    contacts = [signals["contacts"] for signals in bus.taken("Bumps")]
    assert contacts == [1, 0, 0, 0]  # touched, let go, and twice to say that it is there
    ring.feel(121, math.pi / 2, [math.pi / 2, -math.pi / 2])
    assert bus.taken("Bumps")[0]["contacts"] == 0b10001
