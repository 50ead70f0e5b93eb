"""Steps on the floor: the lidar's direction and place on the robot, the wheels' radius, the track."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import msgspec
import numpy as np

from robrain.algorithms.localization.scan_match import beam_ends
from robrain.algorithms.localization.wheel_calibration import (
    SquareEnd,
    SquareErrors,
    followed,
    odometry_errors,
    scan_motion,
    still_points,
)
from robrain.algorithms.navigation.wheel_bases import Differential, Mecanum, Omni, OmniBase, WheelBase
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.deploy.bringup.bench import IMU, LIDAR, START_S, Bench, MotionFailed, Record, Rest, Straight, TurnOnSpot
from robrain.deploy.bringup.findings import BringUpOperator, CheckFinding, CheckStep, FindingKind, Patch, conclude
from robrain.deploy.bringup.wheel_checks import base_patch
from robrain.plugins.device.imu import ImuSample
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice
from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.device.scan.lidar_device import Mount
from robrain.protocol.model.geometry import Pose2D

STILL_S = 1.2
"""Scanning time at one place: several turns, of which each beam's median counts."""
FIRST_TURN_RAD, FIRST_DRIVE_M = math.radians(60.0), 0.3
LONGEST_DRIVE_M, SHORTEST_DRIVE_M = 1.2, 0.25
SPARE_M = 0.25
"""Between an obstacle ahead and the robot's edge at the end of a path."""
QUARTERS = 4
TURNED_RAD = math.radians(1.0)
MOVED_M = 0.015
RADIUS_TOLERANCE, TRACK_TOLERANCE = 0.01, 0.01
NO_SIGHT = "the lidar does not see enough walls to tell how it moved"
MORE_WALLS = "do this where walls in several directions are within the lidar's range"


class NoSight(MotionFailed):
    """The scans before and after a motion could not be matched."""

    def __init__(self) -> None:
        super().__init__(NO_SIGHT)


class PosedScan(NamedTuple):
    """Points that the lidar sees from where it stands."""

    points: Floats
    """(K, 2), metres, in the robot's frame as its file has it."""
    odometry: Pose2D
    """T_odom_robot there."""


class Moved(NamedTuple):
    """A motion, twice: as the lidar saw it, and as the odometry has it."""

    scan: Pose2D
    """T_before_after of the scan's frame."""
    scan_yaw_rad: float
    """Not wrapped."""
    odometry: Pose2D
    odometry_yaw_rad: float


def scan_around(bench: Bench) -> tuple[PosedScan, Record]:
    """Record lidar scans while the robot stands still; return the static points at its pose, and the record."""
    record = bench.perform(Rest(STILL_S))
    scans = [(scan.angles_rad, scan.ranges_m) for scan in record.scans]
    points = still_points(scans, record.scans[-1].range_max_m) if scans else np.empty((0, 2))
    return PosedScan(points, record.samples[-1].pose), record


def seen_motion(before: PosedScan, scans: Sequence[LaserScan], after: PosedScan) -> tuple[Pose2D, float]:
    """Motion of the lidar between two places, from its scans: T_before_after and the yaw, not wrapped (NoSight)."""
    seen = followed(before.points, map(points_of, scans), after.points)
    if seen is None:
        raise NoSight
    return seen


def move(bench: Bench, before: PosedScan, motion: Straight | TurnOnSpot) -> tuple[Moved, PosedScan]:
    """Execute a motion and scan again (NoSight)."""
    record = bench.perform(motion)
    after, _ = scan_around(bench)
    odometry = before.odometry.inverse().compose(after.odometry)
    return Moved(*seen_motion(before, record.scans, after), odometry, record.samples[-1].yaw_rad), after


def check_scan(bench: Bench) -> CheckFinding:
    """Whether the lidar turns and gives ranges."""
    fault = bench.fault_of(LIDAR)
    scans, radius_m = scan_around(bench)[1].scans, _radius_m(bench)
    if fault or len(scans) < 2:
        sentence = f"the lidar's device does not run: {fault}" if fault else "the lidar has sent no turns"
        remedy = "check the lidar's power, port and device; [robot.roles] scan says which plugin reads it"
        return conclude(CheckStep.SCAN, FindingKind.NO_SCANS, sentence, remedy)
    rate_hz = (len(scans) - 1) / max(1e-9 * (scans[-1].stamp_ns - scans[0].stamp_ns), 1e-3)
    hit = scans[-1].ranges_m < scans[-1].range_max_m
    own = int(((scans[-1].ranges_m < radius_m) & hit).sum())
    values = {"rate_hz": rate_hz, "beams": float(len(hit))}
    values |= {"share_with_return": float(hit.mean()), "beams_within_hull": float(own)}
    sentence = f"{rate_hz:.1f} turns a second of {len(hit)} beams, {100 * hit.mean():.0f} % with a return"
    if own:
        sentence += f"; {own} end within the robot's own radius"
    remedy = "set mount.hidden_within_m of [parameters.scan] to the robot's radius" if own else ""
    return conclude(CheckStep.SCAN, FindingKind.RIGHT, sentence, remedy, values=values)


def check_orientation(bench: Bench) -> list[CheckFinding]:
    """Turn a little to the left and drive a little ahead: whether the scan is mirrored, and where its front looks."""
    turned, view = move(bench, scan_around(bench)[0], TurnOnSpot(FIRST_TURN_RAD))
    share = turned.scan_yaw_rad / turned.odometry_yaw_rad
    values = {"turned_by_odometry_rad": turned.odometry_yaw_rad, "turned_by_scan_rad": turned.scan_yaw_rad}
    if abs(share) < 0.3:
        sentence = f"the scan turns by {turned.scan_yaw_rad:.2f} rad while the wheels turn the robot by "
        sentence += f"{turned.odometry_yaw_rad:.2f} rad"
        remedy = "see that the robot turns on the floor, and that the lidar sees walls and not the robot"
        return [conclude(CheckStep.ORIENTATION, FindingKind.FAILED, sentence, remedy, values=values)]
    driven, view = move(bench, view, Straight(FIRST_DRIVE_M))
    yaw_rad = _direction_rad(driven.scan, is_mirrored=share < 0)
    bench.perform(Straight(-FIRST_DRIVE_M))  # back to where the person has put it
    bench.perform(TurnOnSpot(-FIRST_TURN_RAD))
    values["scan_yaw_rad"] = yaw_rad
    return _orientation(bench, CheckStep.ORIENTATION, yaw_rad, is_mirrored=share < 0, values=values)


def check_distance(bench: Bench) -> list[CheckFinding]:
    """Drive as far as there is room: the wheels' radius, and once more the scan's front."""
    view, base = scan_around(bench)[0], bench.base()
    room_m = _room_m(view, _radius_m(bench))
    if room_m == 0.0:
        sentence = f"there is no room to drive {SHORTEST_DRIVE_M:g} m"
        remedy = "turn the robot to where it has 1.5 m ahead"
        return [conclude(CheckStep.DISTANCE, FindingKind.NOT_DONE, sentence, remedy)]
    driven, view = move(bench, view, Straight(room_m))
    back, _ = move(bench, view, Straight(-room_m))
    true_m = 0.5 * (_length_m(driven.scan) + _length_m(back.scan))
    by_odometry_m = 0.5 * (_length_m(driven.odometry) + _length_m(back.odometry))
    ratio = true_m / by_odometry_m
    values = {"by_odometry_m": by_odometry_m, "by_scan_m": true_m}
    yaw_rad = _direction_rad(driven.scan if room_m > 0 else back.scan, is_mirrored=False)
    found = []
    if abs(yaw_rad) > TURNED_RAD:
        found += _orientation(bench, CheckStep.DISTANCE, yaw_rad, is_mirrored=False, values={"scan_yaw_rad": yaw_rad})
    sentence = f"{by_odometry_m:.3f} m by the wheels are {true_m:.3f} m by the lidar"
    if abs(ratio - 1.0) <= RADIUS_TOLERANCE:
        return [*found, conclude(CheckStep.DISTANCE, FindingKind.RIGHT, sentence, values=values)]
    patch: Patch = {}
    if base is not None:
        radius_m = base.base.wheel_radius_m * ratio
        values["wheel_radius_m"] = radius_m
        sentence += f": the wheels' radius is {radius_m:.4g} m, not {base.base.wheel_radius_m:g} m"
        patch = base_patch(base.base, wheel_radius_m=radius_m)
    wrong = conclude(CheckStep.DISTANCE, FindingKind.WRONG_WHEEL_RADIUS, sentence, values=values, patch=patch)
    return [*found, wrong]


def check_turn(bench: Bench) -> list[CheckFinding]:
    """A full turn on the spot, in quarters: the track, and where on the robot the lidar sits."""
    by_scan_rad = by_odometry_rad = 0.0
    T_first_scan = Pose2D(0.0, 0.0, 0.0)
    first = view = scan_around(bench)[0]
    levers, offsets = [], []
    for _ in range(QUARTERS):
        turned, view = move(bench, view, TurnOnSpot(0.5 * math.pi))
        by_scan_rad += turned.scan_yaw_rad
        by_odometry_rad += turned.odometry_yaw_rad
        T_first_scan = T_first_scan.compose(turned.scan)
        # The lidar at m is moved by R·m − m, and by the motion of the robot's centre.
        centre = first.odometry.inverse().compose(view.odometry)
        cos, sin = math.cos(T_first_scan.yaw_rad) - 1.0, math.sin(T_first_scan.yaw_rad)
        levers += [[cos, -sin], [sin, cos]]
        offsets += [T_first_scan.x_m - centre.x_m, T_first_scan.y_m - centre.y_m]
    x_m, y_m = np.linalg.lstsq(np.array(levers), np.array(offsets), rcond=None)[0].tolist()
    track = _track(bench.base(), by_scan_rad, by_odometry_rad)
    values = {"lidar_x_m": x_m, "lidar_y_m": y_m}
    if math.hypot(x_m, y_m) <= MOVED_M:
        sentence = f"the lidar is where the file has it, to {1000 * math.hypot(x_m, y_m):.0f} mm"
        return [track, conclude(CheckStep.TURN, FindingKind.RIGHT, sentence, values=values)]
    mount = _mount(bench)
    patch: Patch = {}
    if mount is not None:
        moved = msgspec.structs.replace(mount, x_m=mount.x_m + x_m, y_m=mount.y_m + y_m)
        patch = _mount_patch(moved)
        values |= {"mount_x_m": moved.x_m, "mount_y_m": moved.y_m}
    sentence = f"the lidar sits {1000 * x_m:.0f} mm ahead and {1000 * y_m:.0f} mm to the left of where the file has it"
    return [track, conclude(CheckStep.TURN, FindingKind.LIDAR_OFF_CENTRE, sentence, values=values, patch=patch)]


def _track(base: WheelDevice.Parameters | None, by_scan_rad: float, by_odometry_rad: float) -> CheckFinding:
    ratio = by_odometry_rad / by_scan_rad
    values = {"by_odometry_rad": by_odometry_rad, "by_scan_rad": by_scan_rad}
    sentence = f"{math.degrees(by_odometry_rad):.1f}° by the wheels are {math.degrees(by_scan_rad):.1f}° by the lidar"
    if abs(ratio - 1.0) <= TRACK_TOLERANCE:
        return conclude(CheckStep.TURN, FindingKind.RIGHT, sentence, values=values)
    patch: Patch = {}
    sizes = _turn_sizes(base.base, ratio) if base is not None else {}
    if base is not None and sizes:
        values |= sizes
        patch = base_patch(base.base, **sizes)
        changes = [f"{key} is {value:.4g}, not {getattr(base.base, key):g}" for key, value in sizes.items()]
        sentence += f": {', '.join(changes)}"
    return conclude(CheckStep.TURN, FindingKind.WRONG_TRACK, sentence, values=values, patch=patch)


def _turn_sizes(base: WheelBase, ratio: float) -> dict[str, float]:
    """The sizes that decide how far the robot turns, as they should be."""
    match base:
        case OmniBase() | Omni():
            return {"wheel_distance_m": base.wheel_distance_m * ratio}
        case Differential():
            return {"track_m": base.track_m * ratio}
        case Mecanum():
            return {"track_m": base.track_m * ratio, "wheelbase_m": base.wheelbase_m * ratio}
    return {}


def _orientation(
    bench: Bench, step: CheckStep, yaw_rad: float, *, is_mirrored: bool, values: dict[str, float]
) -> list[CheckFinding]:
    is_turned = abs(yaw_rad) > TURNED_RAD
    if not is_mirrored and not is_turned:
        sentence = f"the scan's front is the robot's, to {abs(math.degrees(yaw_rad)):.1f}°, and turns as the robot does"
        return [conclude(step, FindingKind.RIGHT, sentence, values=values)]
    mount = _mount(bench)
    patch: Patch = {}
    if mount is not None:
        sign = -1.0 if is_mirrored else 1.0
        cos, sin, y_m = math.cos(yaw_rad), math.sin(yaw_rad), sign * mount.y_m
        patch = _mount_patch(
            msgspec.structs.replace(
                mount,
                x_m=cos * mount.x_m - sin * y_m,
                y_m=sin * mount.x_m + cos * y_m,
                yaw_rad=math.remainder(yaw_rad + sign * mount.yaw_rad, math.tau),
                upside_down=mount.upside_down != is_mirrored,
            )
        )
    degrees = math.degrees(yaw_rad)
    sentences = {}
    if is_mirrored:
        sentences[FindingKind.SCAN_MIRRORED] = "the scan turns the wrong way: the lidar hangs upside down"
    if is_turned:
        side = "left" if degrees > 0 else "right"
        sentences[FindingKind.SCAN_TURNED] = f"the scan is turned: its front looks {abs(degrees):.1f}° to the {side}"
    remedy = "" if patch else "turn the lidar on the robot, or say so to what publishes its scans"
    return [conclude(step, kind, text, remedy, values=values, patch=patch) for kind, text in sentences.items()]


def _length_m(moved: Pose2D) -> float:
    return math.hypot(moved.x_m, moved.y_m)


def _direction_rad(moved: Pose2D, *, is_mirrored: bool) -> float:
    """Yaw of the scan's front in the robot's frame, from how the scan's origin moved while the robot drove ahead.

    A robot with unequal wheels drives an arc; the chord from its start to its end is turned by half the arc's angle.
    """
    sign = -1.0 if is_mirrored else 1.0
    return math.remainder(0.5 * sign * moved.yaw_rad - math.atan2(sign * moved.y_m, moved.x_m), math.tau)


def _room_m(view: PosedScan, radius_m: float) -> float:
    """Distance that the robot can drive: ahead, or negative for back if there is more room; 0 if nowhere."""
    points = view.points[np.hypot(view.points[:, 0], view.points[:, 1]) > radius_m]
    aside = points[np.abs(points[:, 1]) < radius_m + 0.1]
    ahead_m = float(aside[aside[:, 0] > 0, 0].min(initial=math.inf)) - radius_m - SPARE_M
    back_m = -float(aside[aside[:, 0] < 0, 0].max(initial=-math.inf)) - radius_m - SPARE_M
    room_m = min(max(ahead_m, back_m), LONGEST_DRIVE_M)
    if room_m < SHORTEST_DRIVE_M:
        return 0.0
    return room_m if ahead_m >= min(back_m, LONGEST_DRIVE_M) else -room_m


def points_of(scan: LaserScan) -> Floats:
    """(K, 2): points that a scan has hit, metres, its own frame."""
    return beam_ends(scan.angles_rad, scan.ranges_m, scan.range_max_m)


def _radius_m(bench: Bench) -> float:
    base = bench.base()
    return base.radius_m if base is not None else float(getattr(bench.parameters("mocdevice"), "radius_m", 0.2))


def _mount(bench: Bench) -> Mount | None:
    """Mount of the lidar by its device; None if its parameters do not have it."""
    mount = getattr(bench.parameters(LIDAR), "mount", None)
    return mount if isinstance(mount, Mount) else None


def _mount_patch(mount: Mount) -> Patch:
    values: dict[str, Any] = {
        "x_m": round(mount.x_m, 3) + 0.0,  # no -0.0
        "y_m": round(mount.y_m, 3) + 0.0,
        "yaw_rad": round(mount.yaw_rad, 4) + 0.0,
        "upside_down": mount.upside_down,
        "hidden_within_m": mount.hidden_within_m,
    }
    return {LIDAR: {"mount": values}}


SIDE_M, SIDE_MIN_M, SIDE_STEP_M = 1.0, 0.4, 0.1
FREE_M = 0.2
"""Around the robot's edge on the whole square."""
CORNERS = 4
SQUARE_TRACK_TOLERANCE, RATIO_TOLERANCE = 0.006, 0.004
"""Precision of one square of 1 m in each direction, with the ends measured to 5 mm and 0.2°."""


def side_m(view: PosedScan, radius_m: float) -> float:
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


def check_square(bench: Bench, operator: BringUpOperator, *, rounds: int, measured: bool) -> list[CheckFinding]:
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
    bench: Bench, before: PosedScan, side: float, corner_rad: float, operator: BringUpOperator | None
) -> tuple[SquareEnd, PosedScan]:
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
    if abs(errors.track_factor - 1.0) > SQUARE_TRACK_TOLERANCE:
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
