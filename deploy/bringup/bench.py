"""Where bring-up's motions are executed: a host with the robot's devices alone, in live or in lockstep."""

import abc
from collections import deque
from importlib import resources
from pathlib import Path
from typing import Any, cast

import msgspec

from robrain.agent.errors import PluginError
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, folder_of
from robrain.agent.plugin import PluginState
from robrain.deploy.bringup.motion_runner import MotionRunner
from robrain.deploy.bringup.motions import Motion, Record
from robrain.plugins.device.mocdevice.interface import Counters
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice
from robrain.protocol.wire.errors import CallError, RobrainError

BASE, LIDAR, BATTERY, IMU, DRIVER = "mocdevice", "scan", "bm2", "imu", "driver"
HALTED_BY = "bringup"
HALTED_S = 1.0
"""A halted host's plugins do nothing; what the encoders say meanwhile is read afterwards."""
LIDAR_START_S, LOOK_S = 8.0, 0.1
"""How long a lidar has for its first turn: some begin to spin when they are asked."""
START_S = 3.0
"""How long devices have to start."""


class MotionFailed(RobrainError):
    """A motion was given up, and the wheels were stopped."""


class DeviceAbsent(RobrainError):
    """A device does not run; the text says which and why."""


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
            MotionFailed: it was given up; the text says why.
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
                    runner.look()
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
        """Parameters of the base; None of one that does not say what its wheels are."""
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

    def why_not(self, plugin: str) -> str:
        """Why a device does not run; empty if it does."""
        try:
            managed = self.host.manager.get(plugin)
        except PluginError as error:
            return str(error)
        return "" if managed.state is PluginState.ACTIVE else managed.why or str(managed.state)

    def keep_gyro_out(self) -> None:
        """Leave the odometry to the wheels, which a unit that is mounted wrongly would turn."""
        self.host.board.yaw_rates = deque(maxlen=0)

    def wait_for_counts(self) -> None:
        """Wait until the wheels' encoders speak; those that do not are left to the steps."""
        for _ in range(round(START_S / LOOK_S)):
            if self.why_not(DRIVER) or self._runner().is_fresh:
                return
            self.pass_time(LOOK_S)

    def wait_for_scan(self) -> None:
        """Wait for the lidar's first scan; a lidar that does not send one is left to the steps."""
        for _ in range(round(LIDAR_START_S / LOOK_S)):
            if not self.why_not(LIDAR) and cast(Any, self.host.manager.get(LIDAR).live_plugin()).latest() is not None:
                return
            self.pass_time(LOOK_S)

    def wait_for_imu(self) -> str:
        """Wait for the first measurement of the inertial unit; why there is none, empty if there is one."""
        why = "it is silent"
        for _ in range(round((START_S + 1.0) / LOOK_S)):
            if absent := self.why_not(IMU):
                why = absent
            elif cast(Any, self.host.manager.get(IMU).live_plugin()).latest() is not None:
                return ""
            self.pass_time(LOOK_S)
        return why

    def _runner(self) -> MotionRunner:
        self._check_runs()
        return cast(MotionRunner, self.host.manager.get(DRIVER).live_plugin())

    def _check_runs(self) -> None:
        why = self.why_not(DRIVER)
        if why and not self.host.manager.halted:
            raise DeviceAbsent(self.why_not(BASE) or why)


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
