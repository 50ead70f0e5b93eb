"""The steps of bring-up in their order; what is found is put into the robot's file before the next step."""

from collections.abc import Callable
from pathlib import Path

import msgspec

from robrain.agent.host.robot_file import RobotFile, read_robot_file
from robrain.deploy.bringup.bench import Bench, DeviceAbsent, MotionFailed, has_imu
from robrain.deploy.bringup.findings import Finding, Found, Report, Step
from robrain.deploy.bringup.floor_checks import View, check_distance, check_orientation, check_scan, check_turn, look
from robrain.deploy.bringup.imu_check import check_imu
from robrain.deploy.bringup.operator import Operator
from robrain.deploy.bringup.robot_edit import patched, write_patch
from robrain.deploy.bringup.square import check_square
from robrain.deploy.bringup.wheel_checks import check_battery, check_bus, check_halt, check_watchdog, check_wheels
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice
from robrain.protocol.model.navigation.wheel_bases import Ackermann

IN_THE_AIR = "Put the robot on a stand, so that all its wheels turn freely"
ON_THE_FLOOR = "Put the robot on the floor, with 1.5 m free all around it and walls within sight of its lidar"


class Wanted(msgspec.Struct, frozen=True, kw_only=True):
    """What is to be done."""

    air: bool = True
    """Steps with the wheels in the air."""
    floor: bool = True
    """Steps on the floor."""
    rounds: int = 1
    """Squares of each kind; 0 for none."""
    measured: bool = False
    """A person measures where squares end."""
    write: bool = True
    """Put what is found into the file."""


class _Ended(Exception):
    """A step has found what makes it unsafe, or useless, to go on."""


class BringUp:
    """One run of the steps.

    Args:
        path: the robot's file.
        bench: closed by its owner.
        operator: the person beside the robot.
        tell: called with each finding.
        robot_file: what is in the file, if it differs from that (endpoints, team).

    """

    def __init__(
        self,
        path: Path,
        bench: Bench,
        operator: Operator,
        tell: Callable[[Finding], None],
        robot_file: RobotFile | None = None,
    ) -> None:
        self._path, self._bench, self._operator, self._tell = path, bench, operator, tell
        self._file = read_robot_file(path) if robot_file is None else robot_file
        self._findings: list[Finding] = []
        self._backup: Path | None = None
        self._step = Step.BUS
        self._with_lidar = False

    def run(self, wanted: Wanted) -> Report:
        """Do all steps that are possible.

        Raises:
            RobrainError: the host cannot start, or the file cannot be written.
            EOFError, KeyboardInterrupt: the person has gone, or ended it; the wheels stand once the bench is closed.

        """
        self._wanted = wanted
        try:
            if wanted.air:
                self._operator.prepare(IN_THE_AIR)
            self._start(with_lidar=False)
            self._air(moves=wanted.air)
            if wanted.floor:
                self._operator.prepare(ON_THE_FLOOR)
                self._start(with_lidar=True)
                self._floor()
        except _Ended:
            pass
        except (MotionFailed, DeviceAbsent) as error:
            self._note([Finding(step=self._step, found=Found.FAILED, ok=False, sentence=str(error))])
        return Report(
            robot=self._file.robot.name,
            file=str(self._path),
            backup=str(self._backup or ""),
            findings=self._findings,
        )

    def _air(self, *, moves: bool) -> None:
        bench = self._bench
        self._do(Step.BUS, check_bus(bench))
        base = bench.base()
        if not moves:
            return
        if base is None or not bench.has_wheels or isinstance(base.base, Ackermann):
            sentence = "this base is not commanded wheel by wheel"
            self._do(Step.WHEELS, [Finding(step=Step.WHEELS, found=Found.NOT_DONE, ok=None, sentence=sentence)])
        else:
            self._step = Step.WHEELS
            self._do(Step.WHEELS, check_wheels(bench, self._operator, base))
            self._step = Step.HALT
            self._do(Step.HALT, [check_halt(bench, self._base())])
            self._step = Step.WATCHDOG
            self._do(Step.WATCHDOG, [check_watchdog(bench, self._base())])
        self._step = Step.BATTERY
        self._do(Step.BATTERY, [check_battery(bench)])

    def _floor(self) -> None:
        bench, base = self._bench, self._bench.base()
        self._step = Step.SCAN
        finding, view = check_scan(bench)
        self._do(Step.SCAN, [finding])
        if base is not None and isinstance(base.base, Ackermann):
            sentence = "this base cannot turn on the spot: measure the lidar's mounting and the track by hand"
            self._do(
                Step.ORIENTATION, [Finding(step=Step.ORIENTATION, found=Found.NOT_DONE, ok=None, sentence=sentence)]
            )
            return
        self._step = Step.ORIENTATION
        found, view = check_orientation(bench, view)
        view = self._look_again(Step.ORIENTATION, found, view)
        self._step = Step.DISTANCE
        found, view = check_distance(bench, view, bench.base())
        view = self._look_again(Step.DISTANCE, found, view)
        self._step = Step.TURN
        found, view = check_turn(bench, view, bench.base())
        view = self._look_again(Step.TURN, found, view)
        if has_imu(self._file):
            self._step = Step.IMU
            self._start(with_lidar=True, with_imu=True)
            bench.keep_gyro_out()
            if not self._do(Step.IMU, check_imu(bench)):
                self._start(with_lidar=True)  # the squares are the wheels' alone
            view, _ = look(bench)
        self._step = Step.SQUARE
        for _ in range(2 if self._wanted.rounds else 0):  # again with what the first ones have corrected
            found, view = check_square(
                bench, view, bench.base(), self._operator, rounds=self._wanted.rounds, measured=self._wanted.measured
            )
            view = self._look_again(Step.SQUARE, found, view)
            if not any(one.patch for one in found):
                break

    def _base(self) -> WheelDevice.Parameters:
        base = self._bench.base()
        assert base is not None
        return base

    def _start(self, *, with_lidar: bool, with_imu: bool = False) -> None:
        self._with_lidar = with_lidar
        self._bench.start(self._file, with_lidar=with_lidar, with_imu=with_imu)
        self._bench.wait_for_counts()
        if with_lidar:
            self._bench.wait_for_scan()

    def _do(self, step: Step, found: list[Finding]) -> bool:
        """Note what a step has found, and go on with that; whether the devices were restarted for it."""
        self._step = step
        self._note(found)
        if any(one.stops for one in found):
            raise _Ended
        if not any(one.patch for one in found):
            return False
        self._start(with_lidar=self._with_lidar)
        return True

    def _look_again(self, step: Step, found: list[Finding], view: View) -> View:
        """As `_do`; what the lidar sees afterwards."""
        return look(self._bench)[0] if self._do(step, found) else view

    def _note(self, found: list[Finding]) -> None:
        for finding in found:
            self._findings.append(finding)
            self._tell(finding)
            if not finding.patch:
                continue
            parameters = patched(self._file.parameters, finding.patch)
            self._file = msgspec.structs.replace(self._file, parameters=parameters)
            if self._wanted.write:
                self._backup = write_patch(self._path, finding.patch, self._backup)
