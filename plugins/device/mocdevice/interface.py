"""Interface of the motor controller."""

from collections.abc import Sequence
from typing import Protocol

import msgspec

from robrain.agent.errors import PluginError
from robrain.protocol.model.geometry import Pose2D, Twist2D


class MotionFault(PluginError):
    """The robot cannot be driven."""


class BusFault(MotionFault):
    """Nothing passes on the bus."""


class MotorFault(MotionFault):
    """The controller is there, and reports that it has failed."""


class DriveCondition(msgspec.Struct, frozen=True):
    """Whether the robot can be driven, when that changes."""

    ok: bool
    why: str = ""


class Counters(msgspec.Struct, frozen=True):
    """Counters of the device's bus."""

    believed: int
    rejected: int
    """Wrong length or checksum, or counts that wheels cannot have made."""
    foreign: int
    """Frames that no device on this robot's bus sends, and commands of another sender."""
    lost: int
    """Encoder frames that did not arrive, from the gaps in their counter."""
    errors: int
    """Error frames of the computer's own CAN controller."""


class ControllerStatus(msgspec.Struct, frozen=True):
    """The controller's last status; see MotorStatus in the DBC file."""

    state: int
    rejected_frames: int = 0
    lost_commands: int = 0
    bus_state: int = 0
    transmit_errors: int = 0
    receive_errors: int = 0


class MocDeviceInterface(Protocol):
    """Velocity commands down, odometry up."""

    def drive(self, twist: Twist2D) -> None:
        """Command a velocity, body frame. It holds for 200 ms: repeat it, or the wheels stop."""

    def stop(self) -> None:
        """Stop the wheels at once."""

    def is_fresh(self) -> bool:
        """Whether the wheel encoders report: without them the robot's motion is unknown."""

    def pose(self) -> Pose2D:
        """T_odom_robot from the wheel encoders; the robot starts at the origin of odom."""

    def pose_if_fresh(self) -> tuple[Pose2D, bool]:
        """`pose` and `is_fresh` in one call, for users that poll many times a second."""

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """T_odom_robot at a time within the last five seconds; the newest pose for times after `odometry_until_ns`."""

    def odometry_until_ns(self) -> int:
        """Time of measurement of the newest wheel counts, robot's clock; 0 before the first.

        For a later time, `pose_at` returns the pose at this time.
        """

    def velocity(self) -> Twist2D:
        """Velocity in the body frame, from the encoders."""

    def radius_m(self) -> float:
        """Radius of the round footprint."""

    def is_holonomic(self) -> bool:
        """Whether the base can drive sideways; otherwise the left part of a velocity is ignored."""

    def turn_radius_min_m(self) -> float:
        """Radius of the tightest turn; 0 for a base that turns on the spot."""

    def counters(self) -> Counters:
        """Frames believed, rejected, foreign and lost, and error frames."""

    def status(self) -> ControllerStatus | None:
        """The controller's last status; None before the first."""


class WheelCounts(msgspec.Struct, frozen=True):
    """Counts of the encoders, and their scale."""

    counts: tuple[int, ...]
    """One for each wheel, with its sign from the robot's file."""
    modulus: int
    """Count at which they wrap."""
    rad_per_tick: float


class WheelsInterface(MocDeviceInterface, Protocol):
    """Additional interface of a base whose wheels are commanded and counted one by one, for bring-up."""

    def drive_wheels(self, values: Sequence[float]) -> None:
        """Send the base's commands directly, in SI units.

        They hold for 200 ms.
        """

    def wheel_counts(self) -> WheelCounts | None:
        """The last counts; None before the first."""
