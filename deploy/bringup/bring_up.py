"""The steps of bring-up in their order; results are put into the robot's file before the next step."""

import math
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, MutableMapping, MutableSequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import tomlkit
from tomlkit.exceptions import TOMLKitError

from robrain.agent.host.robot_file import RobotFile, read_robot_file
from robrain.algorithms.localization.wheel_calibration import (
    SquareEnd,
    SquareErrors,
    followed,
    odometry_errors,
    scan_motion,
)
from robrain.algorithms.navigation.wheel_bases import Ackermann, Differential, Omni, OmniBase
from robrain.deploy.bringup.bench import IMU, Bench, DeviceAbsent, MotionFailed, Straight, TurnOnSpot, has_imu
from robrain.deploy.bringup.findings import Attendant, BringUpReport, CheckFinding, CheckStep, FindingKind, Patch
from robrain.deploy.bringup.floor_checks import (
    MORE_WALLS,
    NO_SIGHT,
    STILL_S,
    View,
    check_distance,
    check_orientation,
    check_scan,
    check_turn,
    look,
    points_of,
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


class SquareMeasurement(NamedTuple):
    """Ends of the squares, real ones less those by odometry."""

    clockwise: list[SquareEnd]
    counter_clockwise: list[SquareEnd]


def side_m(view: View, radius_m: float) -> float:
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


def check_square(
    bench: Bench, view: View, base: WheelDevice.Parameters | None, operator: Attendant, *, rounds: int, measured: bool
) -> tuple[list[CheckFinding], View]:
    """Drive squares to the left and to the right.

    Args:
        bench: with the robot's file as it is known by now.
        view: the lidar's measurements where the squares begin.
        base: parameters of the base; None if they are not known.
        operator: measures the ends if `measured`.
        rounds: squares of each kind.
        measured: have a person measure the ends instead of the lidar.

    """
    radius_m = base.radius_m if base is not None else 0.2
    side = side_m(view, radius_m)
    if side == 0.0:
        sentence = f"there is no room for a square of {SIDE_MIN_M:g} m to the left and to the right"
        remedy = f"put the robot where it has {SIDE_MIN_M + radius_m + FREE_M:.1f} m ahead and at both sides"
        return [CheckFinding(CheckStep.SQUARE, FindingKind.NOT_DONE, None, sentence, remedy=remedy)], view
    ends = SquareMeasurement([], [])
    for _ in range(rounds):
        for list_of, corner_rad in ((ends.counter_clockwise, 0.5 * math.pi), (ends.clockwise, -0.5 * math.pi)):
            end, view = _drive(bench, view, side, corner_rad, operator if measured else None)
            if end is None:
                finding = CheckFinding(CheckStep.SQUARE, FindingKind.FAILED, False, NO_SIGHT, remedy=MORE_WALLS)
                return [finding], view
            list_of.append(end)
    return _judge(ends, side, base), view


def _drive(
    bench: Bench, before: View, side: float, corner_rad: float, operator: Attendant | None
) -> tuple[SquareEnd | None, View]:
    """One square; where it really ended less where it did by odometry, in the frame of its start."""
    scans: list[LaserScan] = []
    for _ in range(CORNERS):
        scans += bench.perform(Straight(side)).scans
        scans += bench.perform(TurnOnSpot(corner_rad)).scans
    after, _ = look(bench)
    by_odometry = before.odometry.inverse().compose(after.odometry)
    if operator is not None:
        x_m = operator.number("How far ahead of its start is the robot's centre, along the start's heading, in metres")
        y_m = operator.number("How far to the left of its start is it, in metres")
        return SquareEnd(x_m - by_odometry.x_m, y_m - by_odometry.y_m), after
    found = scan_motion(before.points, after.points, by_odometry)
    true = found.pose if found is not None and found.is_held else None
    if true is None:
        way = followed(before.points, map(points_of, scans), after.points)
        true = None if way is None else way[0]
    if true is None:
        return None, after
    yaw_rad = math.remainder(true.yaw_rad - by_odometry.yaw_rad, math.tau)
    return SquareEnd(true.x_m - by_odometry.x_m, true.y_m - by_odometry.y_m, yaw_rad), after


def _judge(ends: SquareMeasurement, side: float, base: WheelDevice.Parameters | None) -> list[CheckFinding]:
    wheels = base.base if base is not None else None
    track_m = wheels.track_m if isinstance(wheels, Differential) else side
    errors = odometry_errors(ends.clockwise, ends.counter_clockwise, side, track_m)
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
        found.append(_wrong_track(errors, base, values, sentence))
    if isinstance(wheels, Differential) and abs(errors.wheel_ratio - 1.0) > RATIO_TOLERANCE:
        ratio = wheels.wheel_radius_ratio * errors.wheel_ratio
        patch = base_patch(wheels, wheel_radius_ratio=ratio)
        if found:  # one table for both
            patch["mocdevice"]["base"] |= {"track_m": found[0].patch["mocdevice"]["base"]["track_m"]}
        found.append(
            CheckFinding(
                CheckStep.SQUARE,
                FindingKind.UNEQUAL_WHEELS,
                False,
                f"{sentence}: the right wheel is {ratio:.4g} times as large as the left one",
                values={**values, "wheel_radius_ratio": ratio},
                patch=patch,
            )
        )
    return found or [CheckFinding(CheckStep.SQUARE, FindingKind.RIGHT, True, sentence, values=values)]


def _wrong_track(
    errors: SquareErrors, base: WheelDevice.Parameters | None, values: dict[str, float], sentence: str
) -> CheckFinding:
    wheels = base.base if base is not None else None
    patch, what = {}, f"corners of 90° were turned by {90 + math.degrees(errors.corner_rad):.1f}°"
    if isinstance(wheels, Differential):
        track_m = wheels.track_m * errors.track_factor
        values, what = {**values, "track_m": track_m}, f"the track is {track_m:.4g} m, not {wheels.track_m:g} m"
        patch = base_patch(wheels, track_m=track_m)
    elif isinstance(wheels, OmniBase | Omni):
        distance_m = wheels.wheel_distance_m * errors.track_factor
        values, what = {**values, "wheel_distance_m": distance_m}, f"the wheels are {distance_m:.4g} m from the centre"
        patch = base_patch(wheels, wheel_distance_m=distance_m)
    return CheckFinding(
        CheckStep.SQUARE, FindingKind.WRONG_TRACK, False, f"{sentence}: {what}", values=values, patch=patch
    )


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
    if why := bench.wait_for_imu():
        return [_absent(f"no measurement from the unit: {why}")]
    view, rest = look(bench)
    if len(rest.imu) < SAMPLES_MIN:
        return [_absent(f"the unit has sent {len(rest.imu)} measurements in {STILL_S:g} s")]
    record = bench.perform(TurnOnSpot(TURN_RAD))
    after, _ = look(bench)
    bench.perform(TurnOnSpot(-TURN_RAD))
    seen = followed(view.points, [points_of(scan) for scan in record.scans], after.points)
    if seen is None:
        return [CheckFinding(CheckStep.IMU, FindingKind.FAILED, False, NO_SIGHT, remedy=MORE_WALLS)]
    bias_rad_s = sum(sample.yaw_rate_rad_s for sample in rest.imu) / len(rest.imu)
    return _findings(bench, turned_rad(record.imu, bias_rad_s), seen[1], bias_rad_s)


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
    return CheckFinding(CheckStep.IMU, FindingKind.NO_IMU, False, sentence, remedy=remedy)


def _findings(bench: Bench, by_imu_rad: float, by_scan_rad: float, bias_rad_s: float) -> list[CheckFinding]:
    ratio = by_imu_rad / by_scan_rad
    values = {"by_imu_rad": by_imu_rad, "by_scan_rad": by_scan_rad, "bias_rad_s": bias_rad_s}
    sentence = f"{math.degrees(by_imu_rad):.1f}° by the unit are {math.degrees(by_scan_rad):.1f}° by the lidar"
    parameters = bench.parameters(IMU)
    found = []

    def say(kind: FindingKind, sentence: str, patch: Patch, remedy: str) -> None:
        found.append(CheckFinding(CheckStep.IMU, kind, False, sentence, values=values, patch=patch, remedy=remedy))

    if ratio < 0 and abs(ratio) > SCALE_TOLERANCE:
        upside_down = getattr(parameters, "upside_down", None)
        patch: Patch = {} if upside_down is None else {IMU: {"upside_down": not upside_down}}
        remedy = "" if patch else "turn it over, or say so to what publishes its measurements"
        say(FindingKind.IMU_INVERTED, f"{sentence}: it is upside down, or counts to the right", patch, remedy)
    if abs(abs(ratio) - 1.0) > SCALE_TOLERANCE:
        patch = _unit_patch(parameters, abs(ratio))
        remedy = "" if patch else "see in its data sheet, and in what prints its lines, in which unit it measures"
        say(
            FindingKind.WRONG_IMU_SCALE,
            f"{sentence}: its turn rate is {abs(ratio):.3g} times what it should be",
            patch,
            remedy,
        )
    if not found:
        found.append(CheckFinding(CheckStep.IMU, FindingKind.RIGHT, True, sentence, values=values))
    return found


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
        tell: called with each finding.
        robot_file: values of the file, where they differ from the given ones (endpoints, team).

    """

    def __init__(
        self,
        path: Path,
        bench: Bench,
        operator: Attendant,
        tell: Callable[[CheckFinding], None],
        robot_file: RobotFile | None = None,
    ) -> None:
        self._path, self._bench, self._operator, self._tell = path, bench, operator, tell
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
            self._record([CheckFinding(self._step, FindingKind.FAILED, False, str(error))])
        return BringUpReport(
            robot=self._file.robot.name,
            file=str(self._path),
            backup=str(self._backup or ""),
            findings=self._findings,
        )

    def _air(self, *, moves: bool) -> None:
        bench = self._bench
        self._do(CheckStep.BUS, check_bus(bench))
        base = bench.base()
        if not moves:
            return
        if base is None or not bench.has_wheels or isinstance(base.base, Ackermann):
            sentence = "this base is not commanded wheel by wheel"
            self._do(
                CheckStep.WHEELS,
                [CheckFinding(CheckStep.WHEELS, FindingKind.NOT_DONE, None, sentence)],
            )
        else:
            self._step = CheckStep.WHEELS
            self._do(CheckStep.WHEELS, check_wheels(bench, self._operator, base))
            self._step = CheckStep.HALT
            self._do(CheckStep.HALT, [check_halt(bench, self._base())])
            self._step = CheckStep.WATCHDOG
            self._do(CheckStep.WATCHDOG, [check_watchdog(bench, self._base())])
        self._step = CheckStep.BATTERY
        self._do(CheckStep.BATTERY, [check_battery(bench)])

    def _floor(self) -> None:
        bench, base = self._bench, self._bench.base()
        self._step = CheckStep.SCAN
        finding, view = check_scan(bench)
        self._do(CheckStep.SCAN, [finding])
        if base is not None and isinstance(base.base, Ackermann):
            sentence = "this base cannot turn on the spot: measure the lidar's mounting and the track by hand"
            self._do(
                CheckStep.ORIENTATION,
                [CheckFinding(CheckStep.ORIENTATION, FindingKind.NOT_DONE, None, sentence)],
            )
            return
        self._step = CheckStep.ORIENTATION
        found, view = check_orientation(bench, view)
        view = self._check_again(CheckStep.ORIENTATION, found, view)
        self._step = CheckStep.DISTANCE
        found, view = check_distance(bench, view, bench.base())
        view = self._check_again(CheckStep.DISTANCE, found, view)
        self._step = CheckStep.TURN
        found, view = check_turn(bench, view, bench.base())
        view = self._check_again(CheckStep.TURN, found, view)
        if has_imu(self._file):
            self._step = CheckStep.IMU
            self._start(with_lidar=True, with_imu=True)
            bench.keep_gyro_out()
            if not self._do(CheckStep.IMU, check_imu(bench)):
                self._start(with_lidar=True)  # the squares are the wheels' alone
            view, _ = look(bench)
        self._step = CheckStep.SQUARE
        for _ in range(2 if self._wanted.rounds else 0):  # again with the corrections of the first ones
            found, view = check_square(
                bench, view, bench.base(), self._operator, rounds=self._wanted.rounds, measured=self._wanted.measured
            )
            view = self._check_again(CheckStep.SQUARE, found, view)
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

    def _do(self, step: CheckStep, found: list[CheckFinding]) -> bool:
        """Record the result of a step, and continue with it; whether the devices were restarted for it."""
        self._step = step
        self._record(found)
        if any(one.stops for one in found):
            raise _Ended
        if not any(one.patch for one in found):
            return False
        self._start(with_lidar=self._with_lidar)
        return True

    def _check_again(self, step: CheckStep, found: list[CheckFinding], view: View) -> View:
        """As `_do`; returns the lidar's measurements afterwards."""
        return look(self._bench)[0] if self._do(step, found) else view

    def _record(self, found: list[CheckFinding]) -> None:
        for finding in found:
            self._findings.append(finding)
            self._tell(finding)
            if not finding.patch:
                continue
            parameters = patched(self._file.parameters, finding.patch)
            self._file = msgspec.structs.replace(self._file, parameters=parameters)
            if self._wanted.write:
                self._backup = write_patch(self._path, finding.patch, self._backup)
