"""The board: what a robot's plugins know of the robot, and the host tells the team."""

from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.wire.messages import BatteryState


class Board:
    """Facts about the robot, each written by the one plugin that knows it.

    The host reads the board ten times a second and publishes it as RobotState.
    """

    def __init__(self) -> None:
        self.pose: Pose2D | None = None
        self.T_arena_odom: Pose2D | None = None
        """The frame of dead reckoning in the team's frame; localisation writes it."""
        self.pose_covariance: tuple[float, ...] = ()
        self.velocity = Twist2D()
        self.radius_m = 0.0
        self.battery: BatteryState | None = None
        self.behavior = ""
