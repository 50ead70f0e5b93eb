"""The robot of examples/ros2_robot, without ROS: it is what tests of ROS 2 devices are measured against."""

import importlib.util
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

SOURCE = Path(__file__).parents[3] / "examples" / "ros2_robot" / "simulated_robot.py"


@pytest.fixture(scope="module")
def robots():
    spec = importlib.util.spec_from_file_location("simulated_robot", SOURCE)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.fixture
def floor(robots, tmp_path):
    """A room of 4 × 3 m with its lower left corner at (0, 0)."""
    grey = np.full((64, 84), 254, np.uint8)
    grey[:2], grey[-2:], grey[:, :2], grey[:, -2:] = 0, 0, 0, 0
    Image.fromarray(grey).save(tmp_path / "room.png")
    (tmp_path / "room.yaml").write_text("image: room.png\nresolution: 0.05\norigin: [-0.1, -0.1, 0.0]\nnegate: 0\n")
    return robots.FloorMap(tmp_path / "room.yaml")


@pytest.fixture
def body(robots, floor):
    return robots.Body(floor, robots.Pose(1.0, 1.0, 0.0), holonomic=False, slip=0.0)


def drive(robots, body, twist, seconds, *, repeat=True, from_s=0.0):
    rng = np.random.default_rng(1)
    for step in range(round(seconds / 0.02)):
        now_s = from_s + 0.02 * step
        if repeat or step == 0:
            body.command(twist, now_s)
        body.step(now_s, 0.02, rng)


def test_it_speeds_up_no_faster_than_it_can_and_no_further_than_its_limit(robots, body):
    drive(robots, body, robots.Twist(5.0, 0.0, 0.0), 0.2)
    assert body.velocity.forward_m_s == pytest.approx(0.3)
    drive(robots, body, robots.Twist(5.0, 0.0, 0.0), 1.0)
    assert body.velocity.forward_m_s == pytest.approx(0.8)
    assert body.odometry.x_m == pytest.approx(body.pose.x_m - 1.0)


def test_half_a_second_after_the_last_command_it_stops(robots, body):
    drive(robots, body, robots.Twist(0.6, 0.0, 0.0), 0.5, repeat=False)
    assert body.velocity.forward_m_s == pytest.approx(0.6)
    drive(robots, body, robots.Twist(0.0, 0.0, math.nan), 0.6, from_s=0.5)
    assert body.velocity.forward_m_s == 0.0


def test_walls_stop_it(robots, body):
    drive(robots, body, robots.Twist(0.8, 0.0, 0.0), 8.0)
    assert body.pose.x_m == pytest.approx(4.0 - body.radius_m, abs=0.06)
    assert body.velocity.forward_m_s == pytest.approx(0.0)


@pytest.mark.parametrize("holonomic", [False, True])
def test_only_on_mecanum_wheels_it_drives_sideways(robots, floor, holonomic):
    body = robots.Body(floor, robots.Pose(1.0, 1.0, 0.0), holonomic=holonomic, slip=0.0)
    drive(robots, body, robots.Twist(0.0, 0.4, 0.0), 1.0)
    assert (body.pose.y_m > 1.2) is holonomic
