"""The board: the plugins' facts about the robot, which the host publishes to the team."""

from collections import deque
from typing import TYPE_CHECKING, Any, TypeVar

from robrain.algorithms.localization.odometry import YawRate
from robrain.algorithms.localization.rssi_ranging import RssiSample
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.claim import Reservation
from robrain.protocol.model.energy_model import EnergyModel
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.map_frame import ARENA

if TYPE_CHECKING:  # a robot that does not navigate has no arrays
    from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid

T = TypeVar("T")

IDLE = "idle"
"""Behavior name of an idle robot."""
HALTED = "halted"
"""Behavior name of a halted robot; its host writes it."""


class Board:
    """Facts about the robot, each written by the one plugin that knows it.

    The host reads the board ten times a second and publishes it as RobotState.
    """

    def __init__(self) -> None:
        self.hardware: object | None = None
        """The robot itself, where it is simulated in this process without devices; None for all others."""
        self.pose: Pose2D | None = None
        self.T_arena_odom: Pose2D | None = None
        """The frame of dead reckoning in the team's frame; localisation writes it."""
        self.T_odom_robot: Pose2D | None = None
        """Dead reckoning; mocdevice writes it, and continues from it after a restart."""
        self.wheel_ticks: tuple[int, ...] | None = None
        """Counts of the wheel encoders at that pose."""
        self.odometry: tuple[tuple[int, Pose2D], ...] = ()
        """Dead reckoning of the last 0.6 s: time of measurement (ns, robot's clock) and T_odom_robot, the oldest first.

        mocdevice writes it in each step if a plugin requests it.
        """
        self.wants_odometry = False
        """Whether a lidar needs `odometry`, as the robot moves while it turns; scan writes it."""
        self.published_odometry: tuple[Pose2D, int] | None = None
        """Of a base that adds up its own odometry: the pose that it reported last, and that message's number."""
        self.yaw_rates: deque[YawRate] = deque(maxlen=256)
        """Measurements of a gyroscope, which the device of an IMU leaves here for the odometry of mocdevice."""
        self.gyro_contradiction: float | None = None
        """The gyroscope's turning as a multiple of the wheels', if they contradict each other. mocdevice writes it; the
        IMU's device empties it at its start."""
        self.has_scanned = False
        """Whether the lidar has ever spoken; scan writes it."""
        self.doubted_scan: list[int] | None = None
        """Ranges (mm) of the turn in which the lidar froze; scan writes it, and hands on no such turn."""
        self.pose_covariance: tuple[float, ...] = ()
        self.lost = ""
        """Why the pose is not to be believed; empty while it is. Localisation writes it."""
        self.map_agreement: float | None = None
        """Share of the beams of recent scans that end at walls of the map, 0 to 1; localisation writes it."""
        self.mote_ranges: deque[RssiSample] = deque(maxlen=256)
        """Signals of motes of known place; mote_ranges leaves them here for localisation."""
        self.frame = ARENA
        """The map frame of the pose and of the map: the arena frame, or the robot's own; mapper writes it."""
        self.map: OccupancyGrid | None = None
        """The team's map as this robot knows it, read-only; mapper writes it."""
        self.is_slowed = False
        """Whether a zone limits the speed of the path that is driven; the path's behavior writes it."""
        self.map_paused = ""
        """Why scans are not put into the map now; empty if they are. Mapper writes it."""
        self.velocity = Twist2D()
        self.radius_m = 0.0
        self.battery: BatteryState | None = None
        self.energy: EnergyModel | None = None
        self.chargers: tuple[Point2D, ...] = ()
        """Places of the chargers that the robot knows, arena frame; home writes it."""
        self.behavior = ""
        """Name of the robot's behavior; the behavior that drives writes it."""
        self.waits_for = ""
        """The robot for which this robot waits; empty if none. The behavior that drives writes it."""
        self.waits_at = ""
        """The zone or door before which this robot waits; empty if none. The behavior that drives writes it."""
        self.reservations: tuple[Reservation, ...] | None = None
        """Requests for zones, of this robot and of those that it receives; None before teammates writes it."""
        self._shared: dict[type, Any] = {}

    def shared(self, kind: type[T]) -> T:
        """The one object of a class that some plugins of this robot share; the first of them to ask makes it."""
        if kind not in self._shared:
            self._shared.setdefault(kind, kind())
        shared: T = self._shared[kind]
        return shared
