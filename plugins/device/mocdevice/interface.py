"""What the motor controller offers."""

from typing import Protocol

from robrain.protocol.model.geometry import Pose2D, Twist2D


class MocDeviceInterface(Protocol):
    """Velocity commands down, odometry up."""

    def drive(self, twist: Twist2D) -> None:
        """Command a velocity, body frame. It holds for 200 ms: repeat it, or the wheels stop."""

    def stop(self) -> None:
        """Stop the wheels at once."""

    def pose(self) -> Pose2D:
        """T_odom_robot from the wheel encoders; the robot starts at the origin of odom."""
        ...

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """T_odom_robot at a time within the last second."""
        ...

    def velocity(self) -> Twist2D:
        """Velocity in the body frame, from the encoders."""
        ...

    def radius_m(self) -> float:
        """Radius of the round footprint."""
        ...
