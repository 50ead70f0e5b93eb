"""Short, slow motions that bring-up asks for, and where they are executed: a host with the robot's devices alone."""

import abc
import math
from collections import deque
from contextlib import suppress
from enum import StrEnum
from importlib import resources
from pathlib import Path
from typing import Any, cast

import msgspec

from robrain.agent.errors import AccessDenied, PluginError
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, folder_of
from robrain.agent.plugin import PluginState, Unit
from robrain.plugins.device.imu import ImuInterface, ImuSample
from robrain.plugins.device.mocdevice.interface import Counters, MocDeviceInterface, WheelCounts, WheelsInterface
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.plugins.unit.driver.driver import Driver
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.errors import CallError, RobrainError
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad

WHEEL_SPEED_RAD_S = 2.0
"""With a wheel of 5 cm: 0.1 m/s."""
SPEED_M_S = 0.15
TURN_RATE_RAD_S = 0.4
RAMP_S = 0.4
"""From standing to full speed."""
LONGEST_S = 120.0
"""Of any motion."""


class StopMode(StrEnum):
    """Method of stopping turning wheels."""

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
    """Reading of the encoders at one step."""

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
    """Observations during a motion."""

    samples: tuple[EncoderSample, ...]
    scans: tuple[LaserScan, ...]
    """Different ones, in their order."""
    imu: tuple[ImuSample, ...] = ()
    """Different ones, in their order; none without a unit, or where it is not watched."""


BASE, LIDAR, BATTERY, IMU, DRIVER = "mocdevice", "scan", "bm2", "imu", "driver"
HALTED_BY = "bringup"
HALTED_S = 1.0
"""A halted host's plugins do nothing; the encoder counts of that time are read afterwards."""
START_S, LIDAR_START_S, POLL_S = 3.0, 8.0, 0.1
"""Timeouts of the devices' start and of a lidar's first turn: some begin to spin on request."""


STEP_S = 0.02
LEASE_NS = to_ns(0.5)
"""The wheels stop this long after the last query for the state of the motion: the caller then hangs. A process that
dies stops them sooner, as no command comes any more.
"""
SETTLE_NS = to_ns(0.8)
"""Recording time after the end, so that the robot stands and lidar turns from there have come."""
SCAN_FRESH_NS = to_ns(1.0)
NEAR_M = 0.10
"""Distance to the robot's edge within which the floor must be free."""
BRAKING_M_S2, BRAKING_RAD_S2 = 0.2, 0.5
CREEP_M_S, CREEP_RAD_S = 0.01, 0.03
DONE_M, DONE_RAD = 0.002, 0.004
HOLD_PER_S = 1.5
"""Turn rate for an error of the heading, and sideways speed for one of the place."""
SAMPLES_MAX = int((LONGEST_S + 10.0) / STEP_S)


class MotionRunner(Unit):
    """See the module. `begin`, `ask` and `abort` are called on bring-up's own thread, and only read or set fields."""

    Parameters = Driver.Parameters
    """The file's `[parameters.driver]` are for the driver and are not used here."""
    period_s = STEP_S
    parameters: Driver.Parameters

    def init(self) -> None:
        self.is_cruising = False
        """Whether wheels turn at full speed and wait to be halted."""
        self.failed = ""
        """Reason why the last motion was given up; empty if it was not."""
        self._wanted: Motion | None = None
        self._motion: Motion | None = None
        self._asked_ns = 0
        self._ended_ns: int | None = None
        self._scan: ScanInterface | None = None
        self._imu: ImuInterface | None = None

    def activate(self) -> None:
        self._moc: MocDeviceInterface = self.env.use("mocdevice", MocDeviceInterface)
        self._wheels: WheelsInterface | None = None
        with suppress(AccessDenied):  # a base that takes velocities alone
            self._wheels = self.env.use("mocdevice", WheelsInterface)

    @property
    def has_wheels(self) -> bool:
        """Whether wheels can be commanded one by one."""
        return self._wheels is not None

    @property
    def is_fresh(self) -> bool:
        """Whether the encoders speak."""
        return self._moc.is_fresh()

    def counters(self) -> Counters:
        """Counters of the base, which this plugin holds."""
        return self._moc.counters()

    def begin(self, motion: Motion) -> None:
        """Execute a motion at the next step, in place of the current one."""
        self.failed, self.is_cruising = "", False
        self._asked_ns = self.env.clock.now_ns()
        self._wanted = motion

    def ask(self) -> bool:
        """Whether the motion has ended; asking keeps it going."""
        self._asked_ns = self.env.clock.now_ns()
        return self._wanted is None and self._motion is None

    def record(self) -> Record:
        """Observations during the last motion."""
        return Record(tuple(self._samples), tuple(self._scans), tuple(self._imu_samples))

    def sample(self) -> None:
        """Add the current encoder counts to the record of a motion that has ended."""
        self._sample(self.env.clock.now_ns())

    def abort(self, reason: str) -> None:
        """Stop the wheels at the next step, if there is a motion."""
        if self._wanted is not None or self._motion is not None:
            self.failed = reason

    def step(self) -> None:
        wanted, self._wanted = self._wanted, None
        if wanted is not None:
            self._start(wanted)
        motion = self._motion
        if motion is None:
            return
        now_ns = self.env.clock.now_ns()
        self._sample(now_ns)
        if self._ended_ns is not None:
            if now_ns - self._ended_ns >= SETTLE_NS:
                if isinstance(motion, TurnWheels):  # after a silence they may turn still
                    self._moc.stop()
                self._motion = None
            return
        reason = self.failed or self._abort_reason(motion, now_ns)
        if reason:
            self.failed = reason
            self._end(now_ns)
        elif isinstance(motion, Rest):
            if self._elapsed_s(now_ns) >= motion.seconds:
                self._ended_ns = now_ns - SETTLE_NS
        elif isinstance(motion, TurnWheels):
            self._turn_wheels(motion, now_ns)
        else:
            self._drive(motion, now_ns)

    def deactivate(self) -> None:
        self._motion = self._wanted = None
        self._moc.stop()

    def emergency_halt(self) -> None:
        self._motion = self._wanted = None
        self.is_cruising = False

    def _start(self, motion: Motion) -> None:
        self._motion = motion
        self._began_ns = self.env.clock.now_ns()
        self._ended_ns = None
        self._samples: list[EncoderSample] = []
        self._scans: list[LaserScan] = []
        self._imu_samples: list[ImuSample] = []
        self._counts = self._read_counts()
        self._turns_rad = [0.0] * (len(self._counts.counts) if self._counts is not None else 0)
        self._from = self._pose = self._moc.pose()
        self._yaw_rad = 0.0

    def _elapsed_s(self, now_ns: int) -> float:
        return to_seconds(now_ns - self._began_ns)

    def _read_counts(self) -> WheelCounts | None:
        return self._wheels.wheel_counts() if self._wheels is not None else None

    def _sample(self, now_ns: int) -> None:
        """Record the encoders, and the scan and the turn rate if there are new ones."""
        counts, before = self._read_counts(), self._counts
        if counts is not None and before is not None:
            half = counts.modulus // 2
            for wheel, (new, old) in enumerate(zip(counts.counts, before.counts, strict=True)):
                steps = (new - old + half) % counts.modulus - half
                self._turns_rad[wheel] += steps * counts.rad_per_tick
        elif counts is not None:
            self._turns_rad = [0.0] * len(counts.counts)
        self._counts = counts
        pose = self._moc.pose()
        self._yaw_rad += wrap_angle_rad(pose.yaw_rad - self._pose.yaw_rad)
        self._pose = pose
        if len(self._samples) < SAMPLES_MAX:
            self._samples.append(
                EncoderSample(
                    self._moc.odometry_until_ns() or now_ns,
                    tuple(self._turns_rad),
                    pose,
                    self._yaw_rad,
                    is_commanded=self._ended_ns is None and not isinstance(self._motion, Rest | None),
                )
            )
        _append_newer(self._scans, self._scan.latest() if self._scan is not None else None)
        _append_newer(self._imu_samples, self._imu.latest() if self._imu is not None else None)

    def _abort_reason(self, motion: Motion, now_ns: int) -> str:
        if isinstance(motion, Rest):
            return ""
        if abs(now_ns - self._asked_ns) > LEASE_NS:  # it may have asked since this step began
            return "who asked for the motion is gone"
        if not self._moc.is_fresh():
            return "no data from the wheel encoders"
        if self._elapsed_s(now_ns) > _time_limit_s(motion):
            return f"it has not ended after {_time_limit_s(motion):.0f} s"
        if isinstance(motion, Straight):
            return self._nearest_obstacle(now_ns)
        return ""

    def _nearest_obstacle(self, now_ns: int) -> str:
        scan, radius_m = self._scan.latest() if self._scan is not None else None, self._moc.radius_m()
        if scan is None or now_ns - scan.stamp_ns > SCAN_FRESH_NS:
            return "no turn of the lidar for 1 s"
        # An echo from within the hull is a part of the robot.
        nearest_m = min((one for one in scan.beam_ranges_m if one > radius_m), default=math.inf)
        return f"something is {nearest_m:.2f} m from the lidar" if nearest_m < radius_m + NEAR_M else ""

    def _ramp(self, now_ns: int) -> float:
        return min(1.0, (self._elapsed_s(now_ns) + STEP_S) / RAMP_S)

    def _turn_wheels(self, motion: TurnWheels, now_ns: int) -> None:
        if self._wheels is None:
            self.failed = "this base takes no commands for single wheels"
            self._end(now_ns)
            return
        if self._elapsed_s(now_ns) >= motion.seconds:
            if motion.ending is not StopMode.HOST:
                self._ended_ns = now_ns
                if motion.ending is StopMode.COMMAND:
                    self._moc.stop()
                return
            self.is_cruising = True
        share = self._ramp(now_ns)
        self._wheels.drive_wheels([share * speed for speed in motion.speeds_rad_s])

    def _drive(self, motion: Straight | TurnOnSpot, now_ns: int) -> None:
        at = self._from.inverse().compose(self._pose)
        if isinstance(motion, TurnOnSpot):
            left_rad = motion.angle_rad - self._yaw_rad
            if abs(left_rad) < DONE_RAD or left_rad * motion.angle_rad < 0:
                self._end(now_ns)
                return
            rate = _towards(left_rad, self._ramp(now_ns), TURN_RATE_RAD_S, BRAKING_RAD_S2, CREEP_RAD_S)
            self._moc.drive(Twist2D(0.0, 0.0, rate))
            return
        left_m = motion.distance_m - at.x_m
        if abs(left_m) < DONE_M or left_m * motion.distance_m < 0:
            self._end(now_ns)
            return
        speed = _towards(left_m, self._ramp(now_ns), SPEED_M_S, BRAKING_M_S2, CREEP_M_S)
        if self._moc.is_holonomic():
            twist = Twist2D(speed, -HOLD_PER_S * at.y_m, -HOLD_PER_S * at.yaw_rad)
        else:
            twist = Twist2D(speed, 0.0, -HOLD_PER_S * at.yaw_rad)
        self._moc.drive(twist)

    def _end(self, now_ns: int) -> None:
        self._moc.stop()
        self._ended_ns = now_ns


class FloorRunner(MotionRunner):
    """With the lidar."""

    def activate(self) -> None:
        super().activate()
        self._scan = self.env.use("scan", ScanInterface)


class ImuRunner(FloorRunner):
    """With the lidar and the inertial measurement unit."""

    def activate(self) -> None:
        super().activate()
        self._imu = self.env.use("imu", ImuInterface)


def _append_newer(samples: list[Any], newest: LaserScan | ImuSample | None) -> None:
    if newest is not None and (not samples or newest.stamp_ns > samples[-1].stamp_ns) and len(samples) < SAMPLES_MAX:
        samples.append(newest)


def _towards(left: float, ramp: float, fastest: float, braking: float, creep: float) -> float:
    speed = min(ramp * fastest, max(math.sqrt(2.0 * braking * abs(left)), creep))
    return math.copysign(speed, left)


def _time_limit_s(motion: Motion) -> float:
    match motion:
        case Straight(distance_m=distance_m):
            needed_s = abs(distance_m) / SPEED_M_S
        case TurnOnSpot(angle_rad=angle):
            needed_s = abs(angle) / TURN_RATE_RAD_S
        case TurnWheels(seconds=seconds) | Rest(seconds=seconds):
            needed_s = seconds
    return min(LONGEST_S, 2.0 * needed_s + 5.0)


class MotionFailed(RobrainError):
    """A motion was given up, and the wheels were stopped."""


class DeviceAbsent(RobrainError):
    """A device does not run; the text names it and gives the reason."""


class Bench(abc.ABC):
    """Runs a robot's devices, and one motion at a time."""

    host: AgentHost

    @abc.abstractmethod
    def start(self, robot_file: RobotFile, *, with_lidar: bool, with_imu: bool = False) -> None:
        """Start the devices again with the parameters of this file.

        Args:
            robot_file: the robot's.
            with_lidar: have motions watch the lidar; without it the lidar need not run.
            with_imu: watch the inertial measurement unit as well.

        Raises:
            RobrainError: the host cannot start.

        """

    @abc.abstractmethod
    def pass_time(self, seconds: float) -> None:
        """Let the devices run for this long."""

    @abc.abstractmethod
    def close(self) -> None:
        """Stop the wheels, and close the devices."""

    def perform(self, motion: Motion) -> Record:
        """Execute a motion; returns when the robot stands again.

        Raises:
            MotionFailed: it was given up; the text gives the reason.
            DeviceAbsent: the base, or a lidar that is watched, does not run.

        """
        runner = self._runner()
        runner.begin(motion)
        try:
            while not runner.ask():
                self.pass_time(0.02)
                self._check_runs()
                if runner.is_cruising:
                    runner.is_cruising = False
                    self.host.halting.halt(HALTED_BY, "bring-up measures how fast the wheels stop")
                    self.pass_time(HALTED_S)
                    self.host.halting.resume(HALTED_BY)
                    self.pass_time(0.2)
                    self._check_runs()
                    runner.sample()
                    break
        except BaseException:
            runner.abort("bring-up was interrupted")
            raise
        if runner.failed:
            raise MotionFailed(runner.failed)
        return runner.record()

    @property
    def has_wheels(self) -> bool:
        """Whether wheels can be commanded one by one."""
        return self._runner().has_wheels

    def counters(self) -> Counters:
        """Counters of the base."""
        return self._runner().counters()

    def parameters(self, plugin: str) -> Any:
        """A device's checked parameters.

        Raises:
            DeviceAbsent: it has none, as it could not be made.

        """
        try:
            return self.host.manager.get(plugin).plugin.parameters
        except PluginError as error:
            raise DeviceAbsent(f"{plugin}: {error}") from error

    def base(self) -> WheelDevice.Parameters | None:
        """Parameters of the base; None if the base does not describe its wheels."""
        found = self.parameters(BASE)
        return found if isinstance(found, WheelDevice.Parameters) else None

    def call(self, plugin: str, function: str) -> Any:
        """Call an external function without arguments; the result as plain data.

        Raises:
            DeviceAbsent: it does not run, or refuses.

        """
        try:
            return msgspec.to_builtins(self.host.manager.get(plugin).call_external(function, b"[]"))
        except (PluginError, CallError) as error:
            raise DeviceAbsent(f"{plugin}: {error}") from error

    def fault_of(self, plugin: str) -> str:
        """Reason why a device does not run; empty if it does."""
        try:
            managed = self.host.manager.get(plugin)
        except PluginError as error:
            return str(error)
        return "" if managed.state is PluginState.ACTIVE else managed.state_reason or str(managed.state)

    def keep_gyro_out(self) -> None:
        """Leave the odometry to the wheels, which a unit that is mounted wrongly would turn."""
        self.host.board.yaw_rates = deque(maxlen=0)

    def wait_for_data(self, plugin: str, timeout_s: float) -> str:
        """Wait for the first data of the wheels (`DRIVER`), the lidar or the inertial unit.

        Returns:
            The reason why there are none; empty if there are. Silent devices are left to the steps.

        """
        reason = "it is silent"
        for _ in range(round(timeout_s / POLL_S)):
            if fault := self.fault_of(plugin):
                reason = fault
            elif self._has_data(cast(Any, self.host.manager.get(plugin).live_plugin())):
                return ""
            self.pass_time(POLL_S)
        return reason

    @staticmethod
    def _has_data(device: Any) -> bool:
        return device.is_fresh if isinstance(device, MotionRunner) else device.latest() is not None

    def _runner(self) -> MotionRunner:
        self._check_runs()
        return cast(MotionRunner, self.host.manager.get(DRIVER).live_plugin())

    def _check_runs(self) -> None:
        fault = self.fault_of(DRIVER)
        if fault and not self.host.manager.halted:
            raise DeviceAbsent(self.fault_of(BASE) or fault)


def has_imu(robot_file: RobotFile) -> bool:
    """Whether the robot has an inertial measurement unit."""
    table = robot_file.robot
    return IMU in table.roles or IMU in (table.load or ())


def bench_file(robot_file: RobotFile, base: Path, *, with_lidar: bool, with_imu: bool = False) -> RobotFile:
    """The file of a host with the devices and bring-up's own driver alone.

    Args:
        robot_file: the robot's.
        base: the folder of that file.
        with_lidar: as for `Bench.start`.
        with_imu: as well.

    """
    table = robot_file.robot
    runner = "imu" if with_imu else "floor" if with_lidar else "wheels"
    own = Path(str(resources.files("robrain.deploy.bringup"))) / "runners" / runner
    roles = {role: name for role, name in table.roles.items() if role != DRIVER}
    places = [str(folder_of(base, place)) for place in table.places]
    return msgspec.structs.replace(
        robot_file,
        robot=msgspec.structs.replace(
            table,
            load=[BASE, LIDAR, BATTERY, *([IMU] if with_imu else []), DRIVER],
            roles=roles,
            places=[*places, str(own)],
            loadable=[],
            consensus=False,
        ),
    )
