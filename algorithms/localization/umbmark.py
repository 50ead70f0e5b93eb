"""UMBmark: what a differential base's odometry gets systematically wrong, from squares driven both ways.

Borenstein and Feng, *Measurement and correction of systematic odometry errors in mobile robots*, IEEE Transactions on
Robotics and Automation 12(6), 1996, sections IV and V. Here the frame is that of REP 103: x along the first leg, y to
the left. A wrong track (type A) turns each corner by α too far; unequal wheels (type B) bend each leg by β to the left.
"""

import math
from collections.abc import Sequence

import msgspec

POSITION_SIGMA_M, YAW_SIGMA_RAD = 0.005, 0.003
"""Uncertainty of a measured end, to weigh its parts against each other."""


class SquareEnd(msgspec.Struct, frozen=True):
    """Where a robot really ended on a square of four legs and four corners, less where its odometry said.

    In the frame of the square's start.
    """

    x_m: float
    y_m: float
    yaw_rad: float | None = None
    """None if it was not measured."""


class SquareErrors(msgspec.Struct, frozen=True):
    """What the two kinds of squares show."""

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
    """What explains the ends of both kinds of squares, to first order.

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
    # The leg's radius is (L/2) / sin(β/2); its inverse, so that a straight leg needs no case of its own.
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
