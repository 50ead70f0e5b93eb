"""A person who drives a robot by hand is warned of the zones that the robot breaks."""

import math

import pytest

from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.model.zone import Zone, ZoneKind, hand_warning

SQUARE = ((1.0, -1.0), (3.0, -1.0), (3.0, 1.0), (1.0, 1.0))
DOCK = Zone(name="dock", kind=ZoneKind.KEEP_OUT, corners_m=SQUARE)
SLOW = Zone(name="slow", kind=ZoneKind.SPEED_LIMIT, corners_m=SQUARE, speed_m_s=0.2)
EAST = Zone(name="east", kind=ZoneKind.DIRECTED, corners_m=SQUARE, direction_rad=0.0)
OTHER = Zone(name="other", kind=ZoneKind.KEEP_OUT, corners_m=SQUARE, robots=("r2",))
BEFORE, INSIDE = Pose2D(0.7, 0.0, 0.0), Pose2D(2.0, 0.0, 0.0)
AHEAD, BACK = Twist2D(forward_m_s=0.25), Twist2D(forward_m_s=-0.25)


@pytest.mark.parametrize(
    ("zone", "pose", "velocity", "warning"),
    [
        (DOCK, BEFORE, AHEAD, "r1 at 0.25 m/s breaks the zone dock: keep out"),
        (DOCK, BEFORE, BACK, ""),
        (DOCK, BEFORE, Twist2D(left_m_s=0.25), ""),
        (DOCK, Pose2D(0.7, 0.0, -math.pi / 2), Twist2D(left_m_s=0.25), "r1 at 0.25 m/s breaks the zone dock: keep out"),
        (DOCK, Pose2D(0.3, 0.0, 0.0), AHEAD, ""),
        (DOCK, INSIDE, Twist2D(), "r1 at 0.00 m/s breaks the zone dock: keep out"),
        (SLOW, INSIDE, AHEAD, "r1 at 0.25 m/s breaks the zone slow: at most 0.2 m/s"),
        (SLOW, INSIDE, Twist2D(forward_m_s=0.205), ""),
        (EAST, INSIDE, AHEAD, ""),
        (EAST, INSIDE, BACK, "r1 at 0.25 m/s breaks the zone east: one way, 0°"),
        (EAST, INSIDE, Twist2D(), ""),
        (OTHER, INSIDE, AHEAD, ""),
    ],
)
def test_a_warning_names_the_zone_and_its_rule(zone, pose, velocity, warning):
    assert hand_warning([zone], "r1", pose, velocity) == warning
