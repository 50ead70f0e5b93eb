"""UMBmark: squares of a simulated robot with wrong wheels tell how wrong they are."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.odometry import moved
from robrain.algorithms.localization.wheel_calibration import SquareEnd, odometry_errors
from robrain.algorithms.navigation.wheel_bases import Differential
from robrain.protocol.model.geometry import Pose2D, Twist2D

SIDE_M, TRACK_M, RADIUS_M = 1.0, 0.3, 0.05


def base(track_m: float = TRACK_M, ratio: float = 1.0) -> Differential:
    return Differential(wheel_radius_m=RADIUS_M, track_m=track_m, encoder_ticks_per_turn=4096, wheel_radius_ratio=ratio)


def end_of_square(true: Differential, said: Differential, corner: float, *, has_yaw: bool = True) -> SquareEnd:
    """Where a robot with the wheels `true` ends if it drives a square by odometry with those that its file says."""
    pose, odometry = Pose2D(0.0, 0.0, 0.0), Pose2D(0.0, 0.0, 0.0)
    for _ in range(4):
        for twist, steps in ((Twist2D(SIDE_M, 0.0, 0.0), 100), (Twist2D(0.0, 0.0, corner * math.pi / 2), 100)):
            part = Twist2D(twist.forward_m_s / steps, 0.0, twist.yaw_rad_s / steps)
            turns = said.wheel_speeds_rad_s(part)
            for _ in range(steps):
                pose, odometry = moved(pose, true.twist(*turns)), moved(odometry, said.twist(*turns))
    yaw_rad = math.remainder(pose.yaw_rad - odometry.yaw_rad, math.tau)
    return SquareEnd(pose.x_m - odometry.x_m, pose.y_m - odometry.y_m, yaw_rad if has_yaw else None)


@pytest.mark.slow
@settings(max_examples=30)
@given(
    track=st.floats(min_value=0.96, max_value=1.04), ratio=st.floats(min_value=0.98, max_value=1.02), yaw=st.booleans()
)
def test_track_and_ratio_of_the_wheels_come_out_as_they_are(track: float, ratio: float, yaw: bool) -> None:
    true, said = base(TRACK_M * track, ratio), base()
    left, right = (end_of_square(true, said, corner, has_yaw=yaw) for corner in (1.0, -1.0))
    errors = odometry_errors([right], [left], SIDE_M, TRACK_M)
    assert errors.track_factor == pytest.approx(track, abs=0.006)
    assert errors.wheel_ratio == pytest.approx(ratio, abs=0.004)


@pytest.mark.parametrize(
    ("clockwise", "counter", "side_m", "track_m"),
    [
        ([], [SquareEnd(0.0, 0.0)], 1.0, 0.3),  # one kind alone does not tell track from wheels
        ([SquareEnd(0.0, 0.0)], [], 1.0, 0.3),
        ([SquareEnd(0.0, 0.0)], [SquareEnd(0.0, 0.0)], 0.0, 0.3),
        ([SquareEnd(0.0, 0.0)], [SquareEnd(0.0, 0.0)], 1.0, -1.0),
    ],
)
def test_without_both_kinds_of_squares_or_sizes_there_is_no_answer(
    clockwise: list[SquareEnd], counter: list[SquareEnd], side_m: float, track_m: float
) -> None:
    with pytest.raises(ValueError, match="expected"):
        odometry_errors(clockwise, counter, side_m, track_m)
