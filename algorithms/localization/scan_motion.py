"""How a lidar has moved between two of its scans, without a map and without knowing where the lidar sits.

Point-to-line ICP: Censi, *An ICP variant using a point-to-line metric*, ICRA 2008.
"""

import math
from collections.abc import Iterable, Sequence

import msgspec
import numpy as np
from scipy.spatial import cKDTree

from robrain.algorithms.localization.scan_match import beam_ends
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Pose2D

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
    """How the lidar moved."""

    pose: Pose2D
    """T_before_after, of the sensor."""
    rms_m: float
    """Of the distances of points from their lines."""
    share: float
    """Share of the points that have a line within the last reach."""
    is_held: bool
    """Whether walls hold all three directions, and most points fit."""


def still_points(scans: Sequence[tuple[Floats, Floats]], range_max_m: float) -> Floats:
    """(K, 2): what several scans from one place have hit, in the order of the directions, sensor's frame, metres.

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
        first: (K, 2) points from where the sensor stood.
        between: those on the way, in their order.
        last: those from where it stands at the end.

    Returns:
        T_first_last, and the yaw that the sensor turned by on the way, not wrapped.

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
