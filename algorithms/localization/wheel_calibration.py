"""Calibration of wheels: Borenstein's square, and the robot's motion as its lidar saw it."""

import math
from collections.abc import Iterable, Sequence

import msgspec
import numpy as np
from scipy.spatial import cKDTree

from robrain.algorithms.localization.scan_match import beam_ends
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Pose2D

POSITION_SIGMA_M, YAW_SIGMA_RAD = 0.005, 0.003
"""Uncertainty of a measured end, to weigh its parts against each other."""


class SquareEnd(msgspec.Struct, frozen=True):
    """True end of a square of four legs and four corners, less the end by odometry.

    In the frame of the square's start.
    """

    x_m: float
    y_m: float
    yaw_rad: float | None = None
    """None if it was not measured."""


class SquareErrors(msgspec.Struct, frozen=True):
    """Errors that the two kinds of squares show."""

    corner_rad: float
    """α: by which each corner of 90° to the left was turned too far."""
    leg_rad: float
    """β: by which the heading changed, to the left, on each leg."""
    track_factor: float
    """Track by that of the file (the inverse of the paper's E_b where that is the odometry's)."""
    wheel_ratio: float
    """Right wheel's diameter by the left one's, by that of the file: the paper's E_d."""
    largest_m: float
    """The paper's E_max,syst: the farther of the two centres of gravity from the start."""


def odometry_errors(
    clockwise: Sequence[SquareEnd], counter_clockwise: Sequence[SquareEnd], side_m: float, track_m: float
) -> SquareErrors:
    """Odometry errors that explain the ends of both kinds of squares, to first order.

    Args:
        clockwise: ends of squares with corners to the right.
        counter_clockwise: ends of those with corners to the left.
        side_m: length of a leg.
        track_m: distance of the wheels by the robot's file.

    Raises:
        ValueError: one of the two kinds is missing, or a length is not above 0.

    """
    if not clockwise or not counter_clockwise:
        raise ValueError("expected squares of both kinds")
    if not (side_m > 0 and track_m > 0):
        raise ValueError(f"expected lengths above 0, got {side_m:g} and {track_m:g}")
    cw_x_m, cw_y_m = _centre(clockwise)
    ccw_x_m, ccw_y_m = _centre(counter_clockwise)
    quarter = 1.0 / (4.0 * side_m)
    # x_ccw = 2L(α + β), x_cw = 2L(α − β), y_ccw = −2L(α + β), y_cw = 2L(α − β)
    corners = [(ccw_x_m + cw_x_m) * quarter, (cw_y_m - ccw_y_m) * quarter]
    legs = [(ccw_x_m - cw_x_m) * quarter, -(cw_y_m + ccw_y_m) * quarter]
    weights = [1.0 / (POSITION_SIGMA_M * quarter) ** 2] * 2
    cw_rad, ccw_rad = _mean_yaw(clockwise), _mean_yaw(counter_clockwise)
    if cw_rad is not None and ccw_rad is not None:  # yaw_ccw = 4α + 4β, yaw_cw = −4α + 4β
        corners.append((ccw_rad - cw_rad) / 8.0)
        legs.append((ccw_rad + cw_rad) / 8.0)
        weights.append(1.0 / (YAW_SIGMA_RAD / 8.0) ** 2)
    corner_rad = math.fsum(w * v for w, v in zip(weights, corners, strict=True)) / sum(weights)
    leg_rad = math.fsum(w * v for w, v in zip(weights, legs, strict=True)) / sum(weights)
    quarter_turn = 0.5 * math.pi
    half_track = 0.5 * track_m
    # The leg's radius is (L/2) / sin(β/2). Its inverse also covers a straight leg.
    bend_per_m = math.sin(0.5 * leg_rad) / (0.5 * side_m)
    return SquareErrors(
        corner_rad,
        leg_rad,
        quarter_turn / (quarter_turn + corner_rad),
        (1.0 + half_track * bend_per_m) / (1.0 - half_track * bend_per_m),
        max(math.hypot(cw_x_m, cw_y_m), math.hypot(ccw_x_m, ccw_y_m)),
    )


def _centre(ends: Sequence[SquareEnd]) -> tuple[float, float]:
    return math.fsum(end.x_m for end in ends) / len(ends), math.fsum(end.y_m for end in ends) / len(ends)


def _mean_yaw(ends: Sequence[SquareEnd]) -> float | None:
    found = [end.yaw_rad for end in ends if end.yaw_rad is not None]
    return math.fsum(found) / len(found) if len(found) == len(ends) else None


REACHES_M = (0.5, 0.3, 0.2, 0.12, 0.08)
"""Largest distance of points that belong together, from the first iterations to the last."""
ITERATIONS = 12
"""With each of them, at most."""
DONE_M, DONE_RAD = 1e-5, 1e-5
SPREAD_M = 0.35
"""Neighbouring points farther apart are not on one wall."""
ROUGH = 0.1
"""Largest ratio of the spread of neighbouring points across their line to that along it."""
POINTS_MIN = 20
SHARE_MIN = 0.5
"""Least share of the points that find a line."""
HELD_MIN = 0.02
"""Least information of the worst held direction, by the number of points: less is a corridor."""
STILL_M = 0.1
"""Ranges in one direction that differ by more from their median are other things, or outliers."""
KEY_M, KEY_RAD = 0.4, 0.5
"""A motion this large is continued from the scan there."""


class ScanMotion(msgspec.Struct, frozen=True):
    """Motion of the lidar."""

    pose: Pose2D
    """T_before_after, of the sensor."""
    rms_m: float
    """Of the distances of points from their lines."""
    share: float
    """Share of the points that have a line within the last reach."""
    is_held: bool
    """Whether walls hold all three directions, and most points fit."""


def still_points(scans: Sequence[tuple[Floats, Floats]], range_max_m: float) -> Floats:
    """(K, 2): points hit by several scans from one place, in the order of the directions, sensor's frame, metres.

    Each direction that most scans have hit is the mean of the points there whose ranges are near their median.

    Args:
        scans: angles (N,) and ranges (N,) of each; N and the angles may differ from scan to scan.
        range_max_m: of the lidar; that much or more is no return.

    Raises:
        ValueError: there are none, or a scan's angles and ranges do not fit.

    """
    if not scans:
        raise ValueError("expected at least one scan")
    points = np.concatenate([beam_ends(angles_rad, ranges_m, range_max_m) for angles_rad, ranges_m in scans])
    directions = max(len(angles_rad) for angles_rad, _ in scans)
    turns = np.arctan2(points[:, 1], points[:, 0]) / math.tau + 0.5
    index = np.floor(turns * directions + 0.5).astype(np.int64) % max(directions, 1)
    order = np.argsort(index, kind="stable")
    points, index = points[order], index[order]
    found = []
    for there in np.split(points, np.flatnonzero(np.diff(index)) + 1):
        if 2 * len(there) <= len(scans):
            continue
        ranges_m = np.hypot(there[:, 0], there[:, 1])
        found.append(there[np.abs(ranges_m - np.sort(ranges_m)[len(ranges_m) // 2]) <= STILL_M].mean(axis=0))
    return np.array(found).reshape(-1, 2)


def scan_motion(before: Floats, after: Floats, guess: Pose2D) -> ScanMotion | None:
    """The motion that lays one scan onto the other; None if there is too little to go by.

    Args:
        before: (K, 2) points of the first scan in the order of its beams, sensor's frame, metres.
        after: (M, 2) those of the second.
        guess: T_before_after, right to about 0.3 m and 0.3 rad.

    """
    lines, normals = _lines(before)
    if len(lines) < POINTS_MIN or len(after) < POINTS_MIN:
        return None
    tree = cKDTree(lines)
    x_m, y_m, yaw_rad = guess.x_m, guess.y_m, guess.yaw_rad
    residual_m, share, held = np.zeros(0), 0.0, 0.0
    for reach_m in REACHES_M:
        for _ in range(ITERATIONS):
            cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
            turned = after @ np.array([[cos, sin], [-sin, cos]])
            there = turned + np.array([x_m, y_m])
            distances, indices = tree.query(there, distance_upper_bound=reach_m)
            found, nearest = np.isfinite(distances), np.asarray(indices)
            share = float(found.mean())
            if found.sum() < POINTS_MIN:
                return None
            normal = normals[nearest[found]]
            residual_m = np.einsum("ij,ij->i", there[found] - lines[nearest[found]], normal)
            lever = turned[found, 0] * normal[:, 1] - turned[found, 1] * normal[:, 0]
            jacobian = np.column_stack((normal, lever))
            weight = 1.0 / np.maximum(1.0, np.abs(residual_m) / max(0.02, 1.5 * float(np.median(np.abs(residual_m)))))
            weighted = jacobian * weight[:, None]
            information = weighted.T @ jacobian
            scale_m = max(float(np.sqrt((lever**2).mean())), 0.1)  # yaw in metres at the mean lever
            scaled = information / np.outer((1.0, 1.0, scale_m), (1.0, 1.0, scale_m))
            held = float(np.linalg.eigvalsh(scaled)[0] / len(residual_m))
            if held <= 1e-9:
                return None
            step = -np.linalg.solve(information, weighted.T @ residual_m)
            x_m, y_m, yaw_rad = x_m + float(step[0]), y_m + float(step[1]), yaw_rad + float(step[2])
            if abs(step[0]) + abs(step[1]) < DONE_M and abs(step[2]) < DONE_RAD:
                break
    rms_m = float(np.sqrt(np.mean(residual_m**2)))
    pose = Pose2D(x_m, y_m, math.remainder(yaw_rad, math.tau))
    return ScanMotion(pose, rms_m, share, is_held=held >= HELD_MIN and share >= SHARE_MIN)


def followed(first: Floats, between: Iterable[Floats], last: Floats) -> tuple[Pose2D, float] | None:
    """The motion from the first to the last of many scans, each close to the one before; None if the thread is lost.

    Args:
        first: (K, 2) points from the sensor's first place.
        between: those along the path, in their order.
        last: those from its place at the end.

    Returns: T_first_last, and the yaw by which the sensor turned on the path, not wrapped.

    """
    key, T_first_key, key_yaw_rad = first, Pose2D(0.0, 0.0, 0.0), 0.0
    guess, step = Pose2D(0.0, 0.0, 0.0), Pose2D(0.0, 0.0, 0.0)
    for points in (*between, last):
        found = scan_motion(key, points, guess.compose(step))
        if found is None or found.share < SHARE_MIN:
            return None
        step, guess = guess.inverse().compose(found.pose), found.pose
        if points is not last and (math.hypot(guess.x_m, guess.y_m) > KEY_M or abs(guess.yaw_rad) > KEY_RAD):
            T_first_key, key_yaw_rad = T_first_key.compose(guess), key_yaw_rad + guess.yaw_rad
            key, guess = points, Pose2D(0.0, 0.0, 0.0)
    chained, yaw_rad = T_first_key.compose(guess), key_yaw_rad + guess.yaw_rad
    direct = scan_motion(first, last, chained)
    if direct is None or not direct.is_held:
        return chained, yaw_rad
    return direct.pose, yaw_rad + math.remainder(direct.pose.yaw_rad - chained.yaw_rad, math.tau)


def _lines(points: Floats) -> tuple[Floats, Floats]:
    """The points (K, 2) that lie on a line with their neighbours, and that line's unit normal (K, 2)."""
    count = len(points)
    if count < 5:
        return points[:0], points[:0]
    around = points[(np.arange(count)[:, None] + np.arange(-2, 3)) % count]  # (K, 5, 2)
    near = np.hypot(*np.moveaxis(around - points[:, None], 2, 0)) < SPREAD_M
    number = near.sum(axis=1)
    mean = (around * near[..., None]).sum(axis=1) / number[:, None]
    off = (around - mean[:, None]) * near[..., None]
    covariance = np.einsum("kij,kil->kjl", off, off)
    values, vectors = np.linalg.eigh(covariance)
    is_line = (number >= 3) & (values[:, 0] < ROUGH * values[:, 1])
    return mean[is_line], vectors[is_line, :, 0]
