"""Short, slow motions that bring-up asks for, and what was seen meanwhile."""

from enum import StrEnum

import msgspec

from robrain.plugins.device.imu.interface import ImuSample
from robrain.plugins.device.scan.interface import LaserScan
from robrain.protocol.model.geometry import Pose2D

WHEEL_SPEED_RAD_S = 2.0
"""With a wheel of 5 cm: 0.1 m/s."""
SPEED_M_S = 0.15
TURN_RATE_RAD_S = 0.4
RAMP_S = 0.4
"""From standing to full speed."""
LONGEST_S = 120.0
"""Of any motion."""


class StopMode(StrEnum):
    """How wheels that turn are stopped."""

    COMMAND = "command"
    """A velocity of 0, then a stop."""
    SILENCE = "silence"
    """No commands any more: the motor controller's watchdog is to stop them."""
    HOST = "host"
    """They turn on until the host is halted."""


class Rest(msgspec.Struct, frozen=True, tag=True):
    """Stand, and look."""

    seconds: float


class TurnWheels(msgspec.Struct, frozen=True, tag=True):
    """Turn wheels by commands, without regard to where the robot goes."""

    speeds_rad_s: tuple[float, ...]
    """Of each of the base's commands."""
    seconds: float
    ending: StopMode = StopMode.COMMAND


class Straight(msgspec.Struct, frozen=True, tag=True):
    """Drive ahead, or back if negative, by odometry, keeping the heading."""

    distance_m: float


class TurnOnSpot(msgspec.Struct, frozen=True, tag=True):
    """Turn, to the left if positive, by odometry; more than a full turn is possible."""

    angle_rad: float


Motion = Rest | TurnWheels | Straight | TurnOnSpot


class EncoderSample(msgspec.Struct, frozen=True):
    """What the encoders said at one step."""

    stamp_ns: int
    """Time of the wheel counts, robot's clock."""
    turns_rad: tuple[float, ...]
    """Of each encoder since the motion began, with the signs and counts per turn of the robot's file."""
    pose: Pose2D
    """T_odom_robot."""
    yaw_rad: float
    """Of `pose`, since the motion began, not wrapped."""
    is_commanded: bool
    """Whether wheels were still commanded to turn."""


class Record(msgspec.Struct, frozen=True):
    """What was seen during a motion."""

    samples: tuple[EncoderSample, ...]
    scans: tuple[LaserScan, ...]
    """Different ones, in their order."""
    imu: tuple[ImuSample, ...] = ()
    """Different ones, in their order; none without a unit, or where it is not watched."""
