"""Hardware parameters of simulated robots."""

from enum import StrEnum
from typing import Any

import msgspec

from robrain.algorithms.navigation.wheel_bases import Differential, OmniBase
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.ranges import Positive
from robrain.sim.firmware.battery import BatterySpec
from robrain.sim.firmware.described_controller import Chassis, frames_of
from robrain.sim.firmware.power_model import PowerModel
from robrain.sim.firmware.range_sensors import RangeSensorSpec
from robrain.sim.firmware.wit_imu import ImuSpec
from robrain.sim.robot.camera import CameraSpec
from robrain.sim.robot.lidar import LidarSpec
from robrain.sim.robot.wheels import WheelSpec


class Controller(StrEnum):
    """Interface of the motor controller of a `chassis`."""

    CAN = "can"
    """By the frames of its DBC file, for the plugin `mocdevice`."""
    LINES = "lines"
    """By lines of text on a serial line, as ROSArduinoBridge, for the plugin `serial_base`; two wheels."""


class RobotHardware(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[robot]`: hardware of every robot of the scenario.

    Raises ValueError if the radius is not above 0.
    """

    base: OmniBase = OmniBase()
    """The three omni wheels that move it."""
    chassis: Chassis | None = None
    """Other wheels instead, on a controller with other frames: `type` is differential (`protocol/can/two_wheels.dbc`),
    omni or mecanum, with four wheels (`four_wheels.dbc`), or ackermann (`car.dbc`)."""
    controller: Controller = Controller.CAN
    """With `chassis`: how its motor controller is reached."""
    radius_m: Positive = 0.2
    """Radius of the robot's footprint, a disc."""
    battery: BatterySpec = BatterySpec()
    power: PowerModel = PowerModel()
    lidar: LidarSpec = LidarSpec()
    range_sensors: RangeSensorSpec = RangeSensorSpec()
    wheels: WheelSpec = WheelSpec()
    camera: CameraSpec = CameraSpec()
    imu: ImuSpec | None = None
    """An inertial measurement unit, whose turn rate the odometry uses; none if absent."""
    consensus: bool = False
    """Whether robots continue without a coordinator, and allocate open tasks among themselves."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.chassis is not None:
            frames_of(self.chassis)
        if self.controller is Controller.LINES and not isinstance(self.chassis, Differential):
            raise ValueError('controller: expected a chassis of type = "differential" for "lines"')


class ArenaRobot(RobotHardware, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A robot to be simulated; its nodes sit on the bus `{name}/can0`."""

    name: str
    start: Pose2D
    load: tuple[str, ...] | None = None
    """Its plugins; all stock ones if None."""
    plugins: dict[str, dict[str, Any]] = msgspec.field(default_factory=dict)
    """Parameters of its plugins."""
    has_lidar: bool = True

    @property
    def disc(self) -> tuple[float, float, float]:
        """x, y and radius of its footprint at the start, arena frame."""
        return self.start.x_m, self.start.y_m, self.radius_m
