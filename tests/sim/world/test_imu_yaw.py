"""Odometry of bases that slip, or are not what the robot takes them for, without and with an inertial unit."""

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robrain import Scenario
from robrain.plugins.device.imu.serial_imu import SerialImu
from robrain.protocol.model.geometry import Twist2D
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.peripherals.serial_plug import SerialPlug
from robrain.sim.peripherals.wit_imu import WitImu
from robrain.sim.world.robot_specs import RobotSpec, RobotType
from tests.plugins.device.serial_device import SerialDevice
from tests.waiting import PATIENCE_S

STILL_S, DRIVEN_S, TICK_S = 1.5, 60.0, 0.02
BIAS_RAD_S = 0.03
TWO_WHEELS = RobotSpec(
    type=RobotType.TWO_WHEELS,
    without=("explore",),
    plugins={"mocdevice": {"base": {"type": "differential", "track_m": 0.36}}},  # 0.3 m in truth
)
SLIPPING = RobotSpec(without=("explore",), hardware={"wheels": {"slip": 0.1, "slip_sigma_m_per_sqrt_m": 0.01}})


class Fitted:
    """A unit on a robot of the simulator: its bytes on a pseudo terminal, and the driver on the robot's board."""

    def __init__(self, run: LockstepRun, folder: Path) -> None:
        self._body = run.arena._robots[0].body
        self._plug = SerialPlug(folder / "ttyUSB0")
        self._unit = WitImu(np.random.default_rng(7), bias_rad_s=BIAS_RAD_S, noise_rad_s=0.005)
        self._device = SerialDevice(SerialImu, port=str(self._plug.path))
        self._device.board, self._device.clock = run.hosts[0].board, run.hosts[0].clock
        self._device.it.activate()
        self._yaw_rad = self._body.yaw_rad

    def tick(self) -> None:
        turned_rad = math.remainder(self._body.yaw_rad - self._yaw_rad, math.tau)
        self._yaw_rad = self._body.yaw_rad
        data = self._unit.run(turned_rad / TICK_S, TICK_S)
        self._plug.send(data)
        deadline_s = time.monotonic() + PATIENCE_S
        while self._device.it._line._port.in_waiting < len(data) and time.monotonic() < deadline_s:
            time.sleep(0.0005)  # the kernel hands the bytes over in its own time
        self._device.it.step()

    def close(self) -> None:
        self._device.it.deactivate()
        self._plug.pull_out()


def drive(second: float) -> Twist2D:
    """It stands, then drives in a circle to the left, with a halt now and then."""
    is_driving = second > STILL_S and second % 10.0 < 9.0
    return Twist2D(0.2, 0.0, 0.5) if is_driving else Twist2D()


def yaw_error_rad(spec: RobotSpec, folder: Path, *, with_imu: bool) -> tuple[float, Any]:
    """Error of the odometry's yaw after a run, and the bias that was found."""
    scenario = Scenario.builtin("arena_small").replace(robots=1, motes=0, roster=(spec,), seed=3)
    run = LockstepRun(scenario.world())
    robot, start = run.arena._robots[0], run.arena._robots[0].body.pose
    fitted = Fitted(run, folder) if with_imu else None
    device, error_rad = run.hosts[0].manager.get("mocdevice").plugin, 0.0
    for tick in range(round(DRIVEN_S / TICK_S)):
        device.drive(drive(tick * TICK_S))
        run.tick()
        if fitted is not None:
            fitted.tick()
        found = start.compose(device.pose())
        # It may be more than a turn.
        error_rad += math.remainder(found.yaw_rad - robot.body.yaw_rad - error_rad, math.tau)
    bias_rad_s = device.gyro_bias_rad_s()
    assert robot.body.distance_m > 5.0
    if fitted is not None:
        fitted.close()
    run.close()
    return abs(error_rad), bias_rad_s


@pytest.mark.parametrize("spec", [TWO_WHEELS, SLIPPING], ids=["wrong track", "slipping wheels"])
def test_yaw_by_the_gyroscope_is_far_better_than_by_such_wheels(spec: RobotSpec, tmp_path: Path) -> None:
    by_wheels_rad, none = yaw_error_rad(spec, tmp_path, with_imu=False)
    by_gyro_rad, bias_rad_s = yaw_error_rad(spec, tmp_path, with_imu=True)
    assert none is None
    assert bias_rad_s == pytest.approx(BIAS_RAD_S, abs=0.002)
    assert by_wheels_rad > 2.0
    assert by_gyro_rad < 0.03
