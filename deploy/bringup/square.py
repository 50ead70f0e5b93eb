"""The last step: squares in both directions, and what their ends say of the odometry (UMBmark)."""

import math
from typing import NamedTuple

from robrain.algorithms.localization.scan_motion import followed, scan_motion
from robrain.algorithms.localization.umbmark import SquareEnd, SquareErrors, odometry_errors
from robrain.algorithms.navigation.omni_drive import OmniBase
from robrain.algorithms.navigation.wheel_bases import Differential, Omni
from robrain.deploy.bringup.bench import Bench
from robrain.deploy.bringup.findings import BringUpFinding, BringUpStep, FindingKind
from robrain.deploy.bringup.floor_checks import MORE_WALLS, NO_SIGHT, View, look, points_of
from robrain.deploy.bringup.motions import Straight, TurnOnSpot
from robrain.deploy.bringup.operator import Operator
from robrain.deploy.bringup.wheel_table import base_patch
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice
from robrain.plugins.device.scan.interface import LaserScan

SIDE_M, SIDE_MIN_M, SIDE_STEP_M = 1.0, 0.4, 0.1
FREE_M = 0.2
"""Around the robot's edge on the whole square."""
CORNERS = 4
TRACK_TOLERANCE, RATIO_TOLERANCE = 0.006, 0.004
"""What one square of 1 m each way can show, with the ends measured to 5 mm and 0.2°."""


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
    bench: Bench, view: View, base: WheelDevice.Parameters | None, operator: Operator, *, rounds: int, measured: bool
) -> tuple[list[BringUpFinding], View]:
    """Drive squares to the left and to the right.

    Args:
        bench: with the robot's file as it is known by now.
        view: what the lidar sees where the squares begin.
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
        return [
            BringUpFinding(
                step=BringUpStep.SQUARE, found=FindingKind.NOT_DONE, ok=None, sentence=sentence, remedy=remedy
            )
        ], view
    ends = SquareMeasurement([], [])
    for _ in range(rounds):
        for list_of, corner_rad in ((ends.counter_clockwise, 0.5 * math.pi), (ends.clockwise, -0.5 * math.pi)):
            end, view = _drive(bench, view, side, corner_rad, operator if measured else None)
            if end is None:
                finding = BringUpFinding(
                    step=BringUpStep.SQUARE, found=FindingKind.FAILED, ok=False, sentence=NO_SIGHT, remedy=MORE_WALLS
                )
                return [finding], view
            list_of.append(end)
    return _judge(ends, side, base), view


def _drive(
    bench: Bench, before: View, side: float, corner_rad: float, operator: Operator | None
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


def _judge(ends: SquareMeasurement, side: float, base: WheelDevice.Parameters | None) -> list[BringUpFinding]:
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
            BringUpFinding(
                step=BringUpStep.SQUARE,
                found=FindingKind.UNEQUAL_WHEELS,
                ok=False,
                sentence=f"{sentence}: the right wheel is {ratio:.4g} times as large as the left one",
                values={**values, "wheel_radius_ratio": ratio},
                patch=patch,
            )
        )
    return found or [
        BringUpFinding(step=BringUpStep.SQUARE, found=FindingKind.RIGHT, ok=True, sentence=sentence, values=values)
    ]


def _wrong_track(
    errors: SquareErrors, base: WheelDevice.Parameters | None, values: dict[str, float], sentence: str
) -> BringUpFinding:
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
    return BringUpFinding(
        step=BringUpStep.SQUARE,
        found=FindingKind.WRONG_TRACK,
        ok=False,
        sentence=f"{sentence}: {what}",
        values=values,
        patch=patch,
    )
