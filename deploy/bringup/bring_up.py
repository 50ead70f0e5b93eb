"""The steps of bring-up in their order; results are put into the robot's file before the next step."""

import math
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, MutableMapping, MutableSequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import tomlkit
from tomlkit.exceptions import TOMLKitError

from robrain.agent.host.robot_file import RobotFile, read_robot_file
from robrain.algorithms.localization.wheel_calibration import SquareEnd, SquareErrors, odometry_errors, scan_motion
from robrain.algorithms.navigation.wheel_bases import Ackermann, Differential, Omni, OmniBase, WheelBase
from robrain.deploy.bringup.bench import (
    DRIVER,
    IMU,
    LIDAR,
    LIDAR_START_S,
    START_S,
    Bench,
    DeviceAbsent,
    MotionFailed,
    Straight,
    TurnOnSpot,
    has_imu,
)
from robrain.deploy.bringup.findings import (
    BringUpReport,
    CheckFinding,
    CheckStep,
    FindingKind,
    Operator,
    Patch,
    conclude,
)
from robrain.deploy.bringup.floor_checks import (
    MORE_WALLS,
    STILL_S,
    NoSight,
    ScanView,
    check_distance,
    check_orientation,
    check_scan,
    check_turn,
    scan_around,
    seen_motion,
)
from robrain.deploy.bringup.wheel_checks import (
    base_patch,
    check_battery,
    check_bus,
    check_halt,
    check_watchdog,
    check_wheels,
)
from robrain.deploy.errors import UsageError
from robrain.plugins.device.imu import ImuSample
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice
from robrain.plugins.device.scan.interface import LaserScan

PARAMETERS = "parameters"
BACKUPS_MAX = 1000


SIDE_M, SIDE_MIN_M, SIDE_STEP_M = 1.0, 0.4, 0.1
FREE_M = 0.2
"""Around the robot's edge on the whole square."""
CORNERS = 4
TRACK_TOLERANCE, RATIO_TOLERANCE = 0.006, 0.004
"""Precision of one square of 1 m in each direction, with the ends measured to 5 mm and 0.2°."""


def side_m(view: ScanView, radius_m: float) -> float:
    """Side of the largest square, to the left and to the right of the robot, that is free; 0 if none is."""
    x_m, y_m = view.points[:, 0], view.points[:, 1]
    is_other = x_m * x_m + y_m * y_m > radius_m * radius_m
    edge_m = radius_m + FREE_M
    side = SIDE_M
    while side >= SIDE_MIN_M - 1e-9:
        inside = (x_m > -edge_m) & (x_m < side + edge_m) & (abs(y_m) < side + edge_m) & is_other
        if not inside.any():
            return round(side, 1)
        side -= SIDE_STEP_M
    return 0.0


def check_square(bench: Bench, operator: Operator, *, rounds: int, measured: bool) -> list[CheckFinding]:
    """Drive squares to the left and to the right.

    Args:
        bench: with the robot's file as it is known by now.
        operator: measures the ends if `measured`.
        rounds: squares of each kind.
        measured: have a person measure the ends instead of the lidar.

    """
    base, view = bench.base(), scan_around(bench)[0]
    radius_m = base.radius_m if base is not None else 0.2
    side = side_m(view, radius_m)
    if side == 0.0:
        sentence = f"there is no room for a square of {SIDE_MIN_M:g} m to the left and to the right"
        remedy = f"put the robot where it has {SIDE_MIN_M + radius_m + FREE_M:.1f} m ahead and at both sides"
        return [conclude(CheckStep.SQUARE, FindingKind.NOT_DONE, sentence, remedy)]
    clockwise: list[SquareEnd] = []
    counter_clockwise: list[SquareEnd] = []
    for _ in range(rounds):
        for ends, corner_rad in ((counter_clockwise, 0.5 * math.pi), (clockwise, -0.5 * math.pi)):
            end, view = _drive_square(bench, view, side, corner_rad, operator if measured else None)
            ends.append(end)
    wheels = base.base if base is not None else None
    track_m = wheels.track_m if isinstance(wheels, Differential) else side
    return _judge_squares(odometry_errors(clockwise, counter_clockwise, side, track_m), side, wheels)


def _drive_square(
    bench: Bench, before: ScanView, side: float, corner_rad: float, operator: Operator | None
) -> tuple[SquareEnd, ScanView]:
    """One square; where it really ended less where it did by odometry, in the frame of its start (NoSight)."""
    scans: list[LaserScan] = []
    for _ in range(CORNERS):
        scans += bench.perform(Straight(side)).scans
        scans += bench.perform(TurnOnSpot(corner_rad)).scans
    after, _ = scan_around(bench)
    by_odometry = before.odometry.inverse().compose(after.odometry)
    if operator is not None:
        x_m = operator.number("How far ahead of its start is the robot's centre, along the start's heading, in metres")
        y_m = operator.number("How far to the left of its start is it, in metres")
        return SquareEnd(x_m - by_odometry.x_m, y_m - by_odometry.y_m), after
    found = scan_motion(before.points, after.points, by_odometry)
    true = found.pose if found is not None and found.is_held else seen_motion(before, scans, after)[0]
    yaw_rad = math.remainder(true.yaw_rad - by_odometry.yaw_rad, math.tau)
    return SquareEnd(true.x_m - by_odometry.x_m, true.y_m - by_odometry.y_m, yaw_rad), after


def _judge_squares(errors: SquareErrors, side: float, wheels: WheelBase | None) -> list[CheckFinding]:
    values = {
        "side_m": side,
        "largest_m": errors.largest_m,
        "corner_rad": errors.corner_rad,
        "leg_rad": errors.leg_rad,
        "track_factor": errors.track_factor,
        "wheel_ratio": errors.wheel_ratio,
    }
    sentence = f"squares of {side:g} m end {1000 * errors.largest_m:.0f} mm from where the odometry has them"
    found = []
    if abs(errors.track_factor - 1.0) > TRACK_TOLERANCE:
        found.append(_wrong_track(errors, wheels, values, sentence))
    if isinstance(wheels, Differential) and abs(errors.wheel_ratio - 1.0) > RATIO_TOLERANCE:
        ratio = wheels.wheel_radius_ratio * errors.wheel_ratio
        patch = base_patch(wheels, wheel_radius_ratio=ratio)
        if found:  # one table for both
            patch["mocdevice"]["base"] |= {"track_m": found[0].patch["mocdevice"]["base"]["track_m"]}
        text = f"{sentence}: the right wheel is {ratio:.4g} times as large as the left one"
        values = {**values, "wheel_radius_ratio": ratio}
        found.append(conclude(CheckStep.SQUARE, FindingKind.UNEQUAL_WHEELS, text, values=values, patch=patch))
    return found or [conclude(CheckStep.SQUARE, FindingKind.RIGHT, sentence, values=values)]


def _wrong_track(
    errors: SquareErrors, wheels: WheelBase | None, values: dict[str, float], sentence: str
) -> CheckFinding:
    patch, what = {}, f"corners of 90° were turned by {90 + math.degrees(errors.corner_rad):.1f}°"
    if isinstance(wheels, Differential):
        track_m = wheels.track_m * errors.track_factor
        values, what = {**values, "track_m": track_m}, f"the track is {track_m:.4g} m, not {wheels.track_m:g} m"
        patch = base_patch(wheels, track_m=track_m)
    elif isinstance(wheels, OmniBase | Omni):
        distance_m = wheels.wheel_distance_m * errors.track_factor
        values, what = {**values, "wheel_distance_m": distance_m}, f"the wheels are {distance_m:.4g} m from the centre"
        patch = base_patch(wheels, wheel_distance_m=distance_m)
    return conclude(CheckStep.SQUARE, FindingKind.WRONG_TRACK, f"{sentence}: {what}", values=values, patch=patch)


def patched(parameters: Mapping[str, Any], patch: Mapping[str, Any]) -> dict[str, Any]:
    """One table over another, within nested tables too; lists are replaced.

    >>> patched({"scan": {"silent_s": 3.0}}, {"scan": {"mount": {"yaw_rad": 1.5}}})
    {'scan': {'silent_s': 3.0, 'mount': {'yaw_rad': 1.5}}}
    """
    found = dict(parameters)
    for key, value in patch.items():
        below = found.get(key)
        found[key] = (
            patched(below if isinstance(below, Mapping) else {}, value) if isinstance(value, Mapping) else value
        )
    return found


def write_patch(path: Path, patch: Patch, backup: Path | None) -> Path:
    """Write new values into a robot's file, which is replaced as a whole or not at all.

    Args:
        path: the file.
        patch: changes of values.
        backup: a copy that was made before; None makes one.

    Returns:
        The copy of the file as it was.

    Raises:
        UsageError: the file is not as it was read, or cannot be written.
        RobotFileError: it would not be a robot's file any more.

    """
    try:
        document = tomlkit.parse(path.read_text(encoding="utf-8-sig"))
        if PARAMETERS not in document:
            document[PARAMETERS] = tomlkit.table(is_super_table=True)
        _put(document[PARAMETERS], patch)
        kept = backup or _backup(path)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".toml")
        new = Path(name)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                stream.write(tomlkit.dumps(document))
                stream.flush()
                os.fsync(stream.fileno())
            read_robot_file(new)
            shutil.copymode(path, new)
            new.replace(path)
        finally:
            new.unlink(missing_ok=True)
    except (OSError, TOMLKitError) as error:
        raise UsageError(f"{path}: cannot write what was found: {error}") from error
    return kept


def _backup(path: Path) -> Path:
    for number in range(1, BACKUPS_MAX):
        copy = path.with_name(f"{path.name}.before-bringup{'' if number == 1 else f'-{number}'}")
        try:
            with path.open("rb") as source, copy.open("xb") as target:
                shutil.copyfileobj(source, target)
        except FileExistsError:
            continue
        shutil.copystat(path, copy)
        return copy
    raise UsageError(f"{path}: too many copies {path.name}.before-bringup-… beside it")


def _put(table: MutableMapping[str, Any], patch: Mapping[str, Any]) -> None:
    for key, value in patch.items():
        there = table.get(key)
        if isinstance(value, Mapping):
            if not isinstance(there, MutableMapping):
                table[key] = tomlkit.table()
            _put(table[key], value)
        elif not _changed_in_place(there, value) and there != value:
            table[key] = value


def _changed_in_place(there: Any, value: Any) -> bool:
    """Change a list of tables one by one, so that their comments stay; whether that was possible."""
    if not (isinstance(there, MutableSequence) and isinstance(value, list) and len(there) == len(value) > 0):
        return False
    if not all(isinstance(one, Mapping) for one in (*there, *value)):
        return False
    for old, new in zip(there, value, strict=True):
        for key in [key for key in old if key not in new]:
            del old[key]
        _put(old, new)
    return True


TURN_RAD = math.radians(90.0)
SAMPLES_MIN = 10
"""While the robot stands, for its bias."""
SCALE_TOLERANCE = 0.05
DEGREES = math.degrees(1.0)


def check_imu(bench: Bench) -> list[CheckFinding]:
    """Turn to the left and back; compare the unit's turning with the lidar's. The bench runs the unit as well."""
    if reason := bench.wait_for_data(IMU, START_S + 1.0):
        return [_absent(f"no measurement from the unit: {reason}")]
    view, rest = scan_around(bench)
    if len(rest.imu) < SAMPLES_MIN:
        return [_absent(f"the unit has sent {len(rest.imu)} measurements in {STILL_S:g} s")]
    record = bench.perform(TurnOnSpot(TURN_RAD))
    after, _ = scan_around(bench)
    bench.perform(TurnOnSpot(-TURN_RAD))
    bias_rad_s = sum(sample.yaw_rate_rad_s for sample in rest.imu) / len(rest.imu)
    by_scan_rad = seen_motion(view, record.scans, after)[1]
    return _imu_findings(bench, turned_rad(record.imu, bias_rad_s), by_scan_rad, bias_rad_s)


def turned_rad(samples: tuple[ImuSample, ...], bias_rad_s: float) -> float:
    """The angle by which a unit has turned, by the trapezoidal rule.

    >>> turned_rad((ImuSample(0, 0.1), ImuSample(500_000_000, 0.5), ImuSample(1_000_000_000, 0.1)), 0.1)
    0.2
    """
    return math.fsum(
        (0.5 * (before.yaw_rate_rad_s + after.yaw_rate_rad_s) - bias_rad_s) * 1e-9 * (after.stamp_ns - before.stamp_ns)
        for before, after in pairwise(samples)
    )


def _absent(sentence: str) -> CheckFinding:
    remedy = "check its power, port, baud and protocol in [parameters.imu]; [robot.roles] imu says what reads it"
    return conclude(CheckStep.IMU, FindingKind.NO_IMU, sentence, remedy)


def _imu_findings(bench: Bench, by_imu_rad: float, by_scan_rad: float, bias_rad_s: float) -> list[CheckFinding]:
    ratio = by_imu_rad / by_scan_rad
    values = {"by_imu_rad": by_imu_rad, "by_scan_rad": by_scan_rad, "bias_rad_s": bias_rad_s}
    sentence = f"{math.degrees(by_imu_rad):.1f}° by the unit are {math.degrees(by_scan_rad):.1f}° by the lidar"
    parameters = bench.parameters(IMU)
    found = []
    if ratio < 0 and abs(ratio) > SCALE_TOLERANCE:
        upside_down = getattr(parameters, "upside_down", None)
        patch: Patch = {} if upside_down is None else {IMU: {"upside_down": not upside_down}}
        text = f"{sentence}: it is upside down, or counts to the right"
        remedy = "" if patch else "turn it over, or say so to what publishes its measurements"
        found.append(conclude(CheckStep.IMU, FindingKind.IMU_INVERTED, text, remedy, values=values, patch=patch))
    if abs(abs(ratio) - 1.0) > SCALE_TOLERANCE:
        patch = _unit_patch(parameters, abs(ratio))
        text = f"{sentence}: its turn rate is {abs(ratio):.3g} times what it should be"
        remedy = "" if patch else "see in its data sheet, and in what prints its lines, in which unit it measures"
        found.append(conclude(CheckStep.IMU, FindingKind.WRONG_IMU_SCALE, text, remedy, values=values, patch=patch))
    return found or [conclude(CheckStep.IMU, FindingKind.RIGHT, sentence, values=values)]


def _unit_patch(parameters: object, ratio: float) -> Patch:
    """The other unit for lines that are in degrees where the file has radians, or the reverse; empty otherwise."""
    lines = getattr(parameters, "lines", None)
    if getattr(parameters, "protocol", None) != "lines" or lines is None:
        return {}
    for unit, other, factor in (("rad/s", "deg/s", DEGREES), ("deg/s", "rad/s", 1.0 / DEGREES)):
        if lines.yaw_rate_unit == unit and abs(ratio / factor - 1.0) <= SCALE_TOLERANCE:
            whole = {key: value for key, value in msgspec.to_builtins(lines).items() if value is not None}
            return {IMU: {"lines": {**whole, "yaw_rate_unit": other}}}  # whole: it replaces the manifest's table
    return {}


IN_THE_AIR = "Put the robot on a stand, so that all its wheels turn freely"
ON_THE_FLOOR = "Put the robot on the floor, with 1.5 m free all around it and walls within sight of its lidar"


class BringUpOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Steps and limits of a bring-up."""

    air: bool = True
    """Steps with the wheels in the air."""
    floor: bool = True
    """Steps on the floor."""
    rounds: int = 1
    """Squares of each kind; 0 for none."""
    measured: bool = False
    """A person measures where squares end."""
    write: bool = True
    """Put the results into the file."""


class _Ended(Exception):
    """The result of a step makes it unsafe, or useless, to continue."""


class BringUp:
    """One run of the steps.

    Args:
        path: the robot's file.
        bench: closed by its owner.
        operator: the person beside the robot.
        on_finding: called with each finding.
        robot_file: values of the file, where they differ from the given ones (endpoints, team).

    """

    def __init__(
        self,
        path: Path,
        bench: Bench,
        operator: Operator,
        on_finding: Callable[[CheckFinding], None],
        robot_file: RobotFile | None = None,
    ) -> None:
        self._path, self._bench, self._operator, self._on_finding = path, bench, operator, on_finding
        self._file = read_robot_file(path) if robot_file is None else robot_file
        self._findings: list[CheckFinding] = []
        self._backup: Path | None = None
        self._step = CheckStep.BUS
        self._with_lidar = False

    def run(self, wanted: BringUpOptions) -> BringUpReport:
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
            remedy = MORE_WALLS if isinstance(error, NoSight) else ""
            self._record([conclude(self._step, FindingKind.FAILED, str(error), remedy)])
        return BringUpReport(
            robot=self._file.robot.name,
            file=str(self._path),
            backup=str(self._backup or ""),
            findings=self._findings,
        )

    def _air(self, *, moves: bool) -> None:
        bench = self._bench
        self._do(CheckStep.BUS, lambda: check_bus(bench))
        base = bench.base()
        if not moves:
            return
        if base is None or not bench.has_wheels or isinstance(base.base, Ackermann):
            self._skip(CheckStep.WHEELS, "this base is not commanded wheel by wheel")
        else:
            self._do(CheckStep.WHEELS, lambda: check_wheels(bench, self._operator, base))
            self._do(CheckStep.HALT, lambda: [check_halt(bench, self._base())])
            self._do(CheckStep.WATCHDOG, lambda: [check_watchdog(bench, self._base())])
        self._do(CheckStep.BATTERY, lambda: [check_battery(bench)])

    def _floor(self) -> None:
        bench, base, wanted = self._bench, self._bench.base(), self._wanted
        self._do(CheckStep.SCAN, lambda: [check_scan(bench)])
        if base is not None and isinstance(base.base, Ackermann):
            sentence = "this base cannot turn on the spot: measure the lidar's mounting and the track by hand"
            self._skip(CheckStep.ORIENTATION, sentence)
            return
        self._do(CheckStep.ORIENTATION, lambda: check_orientation(bench))
        self._do(CheckStep.DISTANCE, lambda: check_distance(bench))
        self._do(CheckStep.TURN, lambda: check_turn(bench))
        if has_imu(self._file):
            self._step = CheckStep.IMU
            self._start(with_lidar=True, with_imu=True)
            bench.keep_gyro_out()
            if not any(one.patch for one in self._do(CheckStep.IMU, lambda: check_imu(bench))):
                self._start(with_lidar=True)  # the squares are the wheels' alone
        for _ in range(2 if wanted.rounds else 0):  # again with the corrections of the first ones
            found = self._do(
                CheckStep.SQUARE,
                lambda: check_square(bench, self._operator, rounds=wanted.rounds, measured=wanted.measured),
            )
            if not any(one.patch for one in found):
                break

    def _base(self) -> WheelDevice.Parameters:
        base = self._bench.base()
        assert base is not None
        return base

    def _start(self, *, with_lidar: bool, with_imu: bool = False) -> None:
        self._with_lidar = with_lidar
        self._bench.start(self._file, with_lidar=with_lidar, with_imu=with_imu)
        self._bench.wait_for_data(DRIVER, START_S)
        if with_lidar:
            self._bench.wait_for_data(LIDAR, LIDAR_START_S)

    def _skip(self, step: CheckStep, sentence: str) -> None:
        self._record([conclude(step, FindingKind.NOT_DONE, sentence)])

    def _do(self, step: CheckStep, check: Callable[[], list[CheckFinding]]) -> list[CheckFinding]:
        """Do a step, record its findings, and start the devices again if they have changed the file."""
        self._step = step
        found = check()
        self._record(found)
        if any(one.stops for one in found):
            raise _Ended
        if any(one.patch for one in found):
            self._start(with_lidar=self._with_lidar)
        return found

    def _record(self, found: list[CheckFinding]) -> None:
        for one in found:
            self._findings.append(one)
            self._on_finding(one)
            if not one.patch:
                continue
            parameters = patched(self._file.parameters, one.patch)
            self._file = msgspec.structs.replace(self._file, parameters=parameters)
            if self._wanted.write:
                self._backup = write_patch(self._path, one.patch, self._backup)
