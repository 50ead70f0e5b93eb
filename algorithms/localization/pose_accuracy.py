"""Accuracy of a robot's pose estimates, and whether it reports when they are wrong."""

import math
from collections.abc import Sequence

from robrain.protocol.model.accuracy import PoseAccuracy
from robrain.protocol.model.geometry import Pose2D, wrap_angle_rad

FAR_OFF_M = 0.5
"""Position error, metres, above which a robot that does not report it diverges silently."""
SIGMAS = 3.0
"""A robot reports an error if this multiple of its standard deviation reaches the error."""
NEES_BOUND = 5.991
"""95 % quantile of the chi-square distribution with two degrees of freedom."""
NEES_MAX = 1e6
"""Limit of one sample's NEES, so that an almost singular covariance leaves the sums finite."""
GAP_MAX_S = 3.0
"""Longest time between two samples, seconds, that counts; a longer gap ends a silent divergence."""


class PoseAccuracyMeter:
    """Accumulates the errors of one robot's poses; takes samples in order of time."""

    def __init__(self) -> None:
        self._last_s: float | None = None
        self._samples = 0
        self._squares_m2 = self._yaw_squares_rad2 = 0.0
        self._max_error_m = 0.0
        self._with_covariance = self._in_band = 0
        self._nees = self._nees_with_yaw = 0.0
        self._lost_s = self._silent_s = self._longest_silent_s = self._silent_for_s = 0.0
        self._error_m: float | None = None
        self._is_lost = False

    def add(self, time_s: float, believed: Pose2D, covariance: Sequence[float], lost: str, true: Pose2D) -> None:
        """Add a sample; it counts for the time since the sample before.

        Args:
            time_s: time of both poses; a sample that is not later than the one before is ignored.
            believed: T_arena_robot estimated by the robot.
            covariance: its 3 × 3 covariance of x, y, yaw, row-major: m², m·rad, rad²; empty if there is none.
            lost: why the robot reports that it is lost; empty if it does not.
            true: true T_arena_robot.

        """
        last_s, self._last_s = self._last_s, time_s
        if last_s is not None and time_s <= last_s:
            self._last_s = last_s
            return
        passed_s = 0.0
        if last_s is not None and time_s - last_s <= GAP_MAX_S:
            passed_s = time_s - last_s
        else:
            self._silent_for_s = 0.0
        dx_m, dy_m = believed.x_m - true.x_m, believed.y_m - true.y_m
        yaw_error_rad = wrap_angle_rad(believed.yaw_rad - true.yaw_rad)
        error_m = self._error_m = math.hypot(dx_m, dy_m)
        self._is_lost = bool(lost)
        if lost:
            self._lost_s += passed_s
        else:
            self._samples += 1
            self._squares_m2 += error_m * error_m
            self._yaw_squares_rad2 += yaw_error_rad * yaw_error_rad
            self._max_error_m = max(self._max_error_m, error_m)
            self._record_nees(covariance, dx_m, dy_m, yaw_error_rad)
        is_reported = bool(lost) or SIGMAS * position_sigma_m(covariance) >= error_m  # False without a covariance
        if error_m > FAR_OFF_M and not is_reported:
            self._silent_s += passed_s
            self._silent_for_s += passed_s
            self._longest_silent_s = max(self._longest_silent_s, self._silent_for_s)
        else:
            self._silent_for_s = 0.0

    @property
    def accuracy(self) -> PoseAccuracy:
        """Figures over all samples so far."""
        count, compared = self._samples, self._with_covariance
        return PoseAccuracy(
            samples=count,
            rmse_m=math.sqrt(self._squares_m2 / count) if count else None,
            max_error_m=self._max_error_m if count else None,
            yaw_rmse_rad=math.sqrt(self._yaw_squares_rad2 / count) if count else None,
            nees=self._nees / compared if compared else None,
            nees_with_yaw=self._nees_with_yaw / compared if compared else None,
            nees_in_band=self._in_band / compared if compared else None,
            lost_s=self._lost_s,
            silent_divergence_s=self._silent_s,
            longest_silent_divergence_s=self._longest_silent_s,
            error_m=self._error_m,
            silent_for_s=self._silent_for_s,
            is_lost=self._is_lost,
        )

    def _record_nees(self, covariance: Sequence[float], dx_m: float, dy_m: float, yaw_error_rad: float) -> None:
        found = nees(covariance, dx_m, dy_m, yaw_error_rad)
        if found is None:
            return
        of_place, with_yaw = found
        self._with_covariance += 1
        self._in_band += of_place <= NEES_BOUND
        self._nees += min(of_place, NEES_MAX)
        self._nees_with_yaw += min(with_yaw, NEES_MAX)


def position_sigma_m(covariance: Sequence[float]) -> float:
    """Longer half-axis of the 1-sigma ellipse of a row-major 3 × 3 covariance of x, y, yaw; nan if there is none.

    >>> position_sigma_m((0.04, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.1))
    0.2
    """
    if len(covariance) != 9:
        return math.nan
    xx, xy, yy = covariance[0], covariance[1], covariance[4]
    largest = (xx + yy) / 2 + math.hypot((xx - yy) / 2, xy)
    return math.sqrt(largest) if largest >= 0 and math.isfinite(largest) else math.nan


def nees(covariance: Sequence[float], dx_m: float, dy_m: float, yaw_error_rad: float) -> tuple[float, float] | None:
    """Normalised estimation error squared of x and y, and of x, y and yaw.

    `covariance` is the row-major 3 × 3 of x, y, yaw; None for an empty one or one that is not positive definite. The
    second follows from the first by block elimination of the yaw.
    """
    if len(covariance) != 9:
        return None
    xx, xy, yy = covariance[0], covariance[1], covariance[4]
    xt, yt, tt = covariance[2], covariance[5], covariance[8]
    determinant = xx * yy - xy * xy
    if not (xx > 0 and determinant > 0):
        return None
    of_place = (yy * dx_m * dx_m - 2.0 * xy * dx_m * dy_m + xx * dy_m * dy_m) / determinant
    # Expected yaw error given x and y, and the remaining variance.
    along_x, along_y = (yy * xt - xy * yt) / determinant, (xx * yt - xy * xt) / determinant
    left = tt - (along_x * xt + along_y * yt)
    if not left > 0:
        return None
    rest = yaw_error_rad - (along_x * dx_m + along_y * dy_m)
    return of_place, of_place + rest * rest / left
