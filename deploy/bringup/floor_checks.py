"""Steps on the floor: the lidar's direction and place on the robot, the wheels' radius, the track."""

import math
from typing import Any, NamedTuple

import msgspec
import numpy as np

from robrain.algorithms.localization.scan_match import beam_ends
from robrain.algorithms.localization.wheel_calibration import followed, still_points
from robrain.algorithms.navigation.wheel_bases import Differential, Mecanum, Omni, OmniBase, WheelBase
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.deploy.bringup.bench import LIDAR, Bench, Record, Rest, Straight, TurnOnSpot
from robrain.deploy.bringup.findings import CheckFinding, CheckStep, FindingKind, Patch
from robrain.deploy.bringup.wheel_checks import base_patch
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice
from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.device.scan.lidar_device import Mount
from robrain.protocol.model.geometry import Pose2D

STILL_S = 1.2
"""Scanning time at one place: several turns, of which each beam's median counts."""
FIRST_TURN_RAD, FIRST_WAY_M = math.radians(60.0), 0.3
LONGEST_WAY_M, SHORTEST_WAY_M = 1.2, 0.25
SPARE_M = 0.25
"""Between an obstacle ahead and the robot's edge at the end of a path."""
QUARTERS = 4
TURNED_RAD = math.radians(1.0)
MOVED_M = 0.015
RADIUS_TOLERANCE, TRACK_TOLERANCE = 0.01, 0.01
NO_SIGHT = "the lidar does not see enough walls to tell how it moved"
MORE_WALLS = "do this where walls in several directions are within the lidar's range"


class View(NamedTuple):
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


def look(bench: Bench) -> tuple[View, Record]:
    """Stand for a while, and return the lidar's measurements."""
    record = bench.perform(Rest(STILL_S))
    scans = [(scan.angles_rad, scan.ranges_m) for scan in record.scans]
    points = still_points(scans, record.scans[-1].range_max_m) if scans else np.empty((0, 2))
    return View(points, record.samples[-1].pose), record


def move(bench: Bench, before: View, motion: Straight | TurnOnSpot) -> tuple[Moved | None, View]:
    """Execute a motion and scan again; None for the motion if the scans could not be matched."""
    record = bench.perform(motion)
    after, _ = look(bench)
    seen = followed(before.points, [points_of(scan) for scan in record.scans], after.points)
    odometry = before.odometry.inverse().compose(after.odometry)
    yaw_rad = record.samples[-1].yaw_rad
    return (None if seen is None else Moved(*seen, odometry, yaw_rad)), after


def check_scan(bench: Bench) -> tuple[CheckFinding, View]:
    """Whether the lidar turns and gives ranges."""
    why = bench.why_not(LIDAR)
    view, record = look(bench)
    scans, radius_m = record.scans, _radius_m(bench)
    if why or len(scans) < 2:
        sentence = f"the lidar's device does not run: {why}" if why else "the lidar has sent no turns"
        remedy = "check the lidar's power, port and device; [robot.roles] scan says which plugin reads it"
        return CheckFinding(CheckStep.SCAN, FindingKind.NO_SCANS, False, sentence, remedy=remedy), view
    rate_hz = (len(scans) - 1) / max(1e-9 * (scans[-1].stamp_ns - scans[0].stamp_ns), 1e-3)
    hit = scans[-1].ranges_m < scans[-1].range_max_m
    own = int(((scans[-1].ranges_m < radius_m) & hit).sum())
    values = {
        "rate_hz": rate_hz,
        "beams": float(len(hit)),
        "share_with_return": float(hit.mean()),
        "beams_within_hull": float(own),
    }
    sentence = f"{rate_hz:.1f} turns a second of {len(hit)} beams, {100 * hit.mean():.0f} % with a return"
    if own:
        sentence += f"; {own} end within the robot's own radius"
    remedy = "set mount.hidden_within_m of [parameters.scan] to the robot's radius" if own else ""
    return CheckFinding(CheckStep.SCAN, FindingKind.RIGHT, True, sentence, values=values, remedy=remedy), view


def check_orientation(bench: Bench, view: View) -> tuple[list[CheckFinding], View]:
    """Turn a little to the left and drive a little ahead: whether the scan is mirrored, and where its front looks."""
    turned, view = move(bench, view, TurnOnSpot(FIRST_TURN_RAD))
    if turned is None:
        return [_blind(CheckStep.ORIENTATION)], view
    share = turned.scan_yaw_rad / turned.odometry_yaw_rad
    values = {"turned_by_odometry_rad": turned.odometry_yaw_rad, "turned_by_scan_rad": turned.scan_yaw_rad}
    if abs(share) < 0.3:
        sentence = f"the scan turns by {turned.scan_yaw_rad:.2f} rad while the wheels turn the robot by "
        sentence += f"{turned.odometry_yaw_rad:.2f} rad"
        finding = CheckFinding(
            CheckStep.ORIENTATION,
            FindingKind.FAILED,
            False,
            sentence,
            values=values,
            remedy="see that the robot turns on the floor, and that the lidar sees walls and not the robot",
        )
        return [finding], view
    driven, view = move(bench, view, Straight(FIRST_WAY_M))
    if driven is None:
        return [_blind(CheckStep.ORIENTATION)], view
    is_mirrored = share < 0
    yaw_rad = _direction_rad(driven.scan, is_mirrored=is_mirrored)
    bench.perform(Straight(-FIRST_WAY_M))  # back to where the person has put it
    bench.perform(TurnOnSpot(-FIRST_TURN_RAD))
    view, _ = look(bench)
    values["scan_yaw_rad"] = yaw_rad
    return _orientation(bench, CheckStep.ORIENTATION, yaw_rad, is_mirrored=is_mirrored, values=values), view


def check_distance(bench: Bench, view: View, base: WheelDevice.Parameters | None) -> tuple[list[CheckFinding], View]:
    """Drive as far as there is room: the wheels' radius, and once more the scan's front."""
    way_m = _room_m(view, _radius_m(bench))
    if way_m == 0.0:
        sentence = f"there is no room to drive {SHORTEST_WAY_M:g} m"
        return [_not_done(CheckStep.DISTANCE, sentence, "turn the robot to where it has 1.5 m ahead")], view
    driven, view = move(bench, view, Straight(way_m))
    back, view = move(bench, view, Straight(-way_m))
    if driven is None or back is None:
        return [_blind(CheckStep.DISTANCE)], view
    true_m = 0.5 * (_length_m(driven.scan) + _length_m(back.scan))
    by_odometry_m = 0.5 * (_length_m(driven.odometry) + _length_m(back.odometry))
    ratio = true_m / by_odometry_m
    values = {"by_odometry_m": by_odometry_m, "by_scan_m": true_m}
    ahead = driven.scan if way_m > 0 else back.scan
    yaw_rad = _direction_rad(ahead, is_mirrored=False)
    found = []
    if abs(yaw_rad) > TURNED_RAD:
        found += _orientation(bench, CheckStep.DISTANCE, yaw_rad, is_mirrored=False, values={"scan_yaw_rad": yaw_rad})
    if abs(ratio - 1.0) <= RADIUS_TOLERANCE:
        sentence = f"{by_odometry_m:.3f} m by the wheels are {true_m:.3f} m by the lidar"
        return [
            *found,
            CheckFinding(CheckStep.DISTANCE, FindingKind.RIGHT, True, sentence, values=values),
        ], view
    sentence = f"{by_odometry_m:.3f} m by the wheels are {true_m:.3f} m by the lidar"
    patch: Patch = {}
    if base is not None:
        radius_m = base.base.wheel_radius_m * ratio
        values["wheel_radius_m"] = radius_m
        sentence += f": the wheels' radius is {radius_m:.4g} m, not {base.base.wheel_radius_m:g} m"
        patch = base_patch(base.base, wheel_radius_m=radius_m)
    finding = CheckFinding(
        CheckStep.DISTANCE, FindingKind.WRONG_WHEEL_RADIUS, False, sentence, values=values, patch=patch
    )
    return [*found, finding], view


def check_turn(bench: Bench, view: View, base: WheelDevice.Parameters | None) -> tuple[list[CheckFinding], View]:
    """A full turn on the spot, in quarters: the track, and where on the robot the lidar sits."""
    by_scan_rad = by_odometry_rad = 0.0
    T_first_scan = Pose2D(0.0, 0.0, 0.0)
    first, levers, offsets = view, [], []
    for _ in range(QUARTERS):
        turned, view = move(bench, view, TurnOnSpot(0.5 * math.pi))
        if turned is None:
            return [_blind(CheckStep.TURN)], view
        by_scan_rad += turned.scan_yaw_rad
        by_odometry_rad += turned.odometry_yaw_rad
        T_first_scan = T_first_scan.compose(turned.scan)
        # The lidar at m is moved by R·m − m, and by the motion of the robot's centre.
        centre = first.odometry.inverse().compose(view.odometry)
        cos, sin = math.cos(T_first_scan.yaw_rad) - 1.0, math.sin(T_first_scan.yaw_rad)
        levers += [[cos, -sin], [sin, cos]]
        offsets += [T_first_scan.x_m - centre.x_m, T_first_scan.y_m - centre.y_m]
    mount_m = np.linalg.lstsq(np.array(levers), np.array(offsets), rcond=None)[0]
    found = [_track(base, by_scan_rad, by_odometry_rad)]
    x_m, y_m = float(mount_m[0]), float(mount_m[1])
    values = {"lidar_x_m": x_m, "lidar_y_m": y_m}
    if math.hypot(x_m, y_m) <= MOVED_M:
        sentence = f"the lidar is where the file has it, to {1000 * math.hypot(x_m, y_m):.0f} mm"
        found.append(CheckFinding(CheckStep.TURN, FindingKind.RIGHT, True, sentence, values=values))
        return found, view
    mount = _mount(bench)
    patch: Patch = {}
    if mount is not None:
        at_m = mount.x_m + x_m, mount.y_m + y_m
        patch = _mount_patch(msgspec.structs.replace(mount, x_m=at_m[0], y_m=at_m[1]))
        values |= {"mount_x_m": at_m[0], "mount_y_m": at_m[1]}
    sentence = f"the lidar sits {1000 * x_m:.0f} mm ahead and {1000 * y_m:.0f} mm to the left of where the file has it"
    found.append(
        CheckFinding(CheckStep.TURN, FindingKind.LIDAR_OFF_CENTRE, False, sentence, values=values, patch=patch)
    )
    return found, view


def _track(base: WheelDevice.Parameters | None, by_scan_rad: float, by_odometry_rad: float) -> CheckFinding:
    ratio = by_odometry_rad / by_scan_rad
    values = {"by_odometry_rad": by_odometry_rad, "by_scan_rad": by_scan_rad}
    sentence = f"{math.degrees(by_odometry_rad):.1f}° by the wheels are {math.degrees(by_scan_rad):.1f}° by the lidar"
    if abs(ratio - 1.0) <= TRACK_TOLERANCE:
        return CheckFinding(CheckStep.TURN, FindingKind.RIGHT, True, sentence, values=values)
    patch: Patch = {}
    sizes = _turn_sizes(base.base, ratio) if base is not None else {}
    if base is not None and sizes:
        values |= sizes
        patch = base_patch(base.base, **sizes)
        sentence += ": " + ", ".join(
            f"{key} is {value:.4g}, not {getattr(base.base, key):g}" for key, value in sizes.items()
        )
    return CheckFinding(CheckStep.TURN, FindingKind.WRONG_TRACK, False, sentence, values=values, patch=patch)


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
    mount = _mount(bench)
    patch: Patch = {}
    if mount is not None and (is_mirrored or is_turned):
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
    remedy = "" if patch else "turn the lidar on the robot, or say so to what publishes its scans"

    def say(found: FindingKind, sentence: str) -> CheckFinding:
        return CheckFinding(step, found, False, sentence, values=values, patch=patch, remedy=remedy)

    found = []
    if is_mirrored:
        found.append(say(FindingKind.SCAN_MIRRORED, "the scan turns the wrong way: the lidar hangs upside down"))
    if is_turned:
        degrees = math.degrees(yaw_rad)
        sentence = (
            f"the scan is turned: its front looks {abs(degrees):.1f}° to the {'left' if degrees > 0 else 'right'}"
        )
        found.append(say(FindingKind.SCAN_TURNED, sentence))
    if not found:
        sentence = f"the scan's front is the robot's, to {abs(math.degrees(yaw_rad)):.1f}°, and turns as the robot does"
        found.append(CheckFinding(step, FindingKind.RIGHT, True, sentence, values=values))
    return found


def _length_m(moved: Pose2D) -> float:
    return math.hypot(moved.x_m, moved.y_m)


def _direction_rad(moved: Pose2D, *, is_mirrored: bool) -> float:
    """Yaw of the scan's front in the robot's frame, from how the scan's origin moved while the robot drove ahead.

    A robot with unequal wheels drives an arc; the chord from its start to its end is turned by half the arc's angle.
    """
    sign = -1.0 if is_mirrored else 1.0
    return math.remainder(0.5 * sign * moved.yaw_rad - math.atan2(sign * moved.y_m, moved.x_m), math.tau)


def _room_m(view: View, radius_m: float) -> float:
    """Distance that the robot can drive: ahead, or negative for back if there is more room; 0 if nowhere."""
    points = view.points[np.hypot(view.points[:, 0], view.points[:, 1]) > radius_m]
    aside = points[np.abs(points[:, 1]) < radius_m + 0.1]
    ahead_m = float(aside[aside[:, 0] > 0, 0].min(initial=math.inf)) - radius_m - SPARE_M
    back_m = -float(aside[aside[:, 0] < 0, 0].max(initial=-math.inf)) - radius_m - SPARE_M
    room_m = min(max(ahead_m, back_m), LONGEST_WAY_M)
    if room_m < SHORTEST_WAY_M:
        return 0.0
    return room_m if ahead_m >= min(back_m, LONGEST_WAY_M) else -room_m


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


def _blind(step: CheckStep) -> CheckFinding:
    return CheckFinding(step, FindingKind.FAILED, False, NO_SIGHT, remedy=MORE_WALLS)


def _not_done(step: CheckStep, sentence: str, remedy: str) -> CheckFinding:
    return CheckFinding(step, FindingKind.NOT_DONE, None, sentence, remedy=remedy)
