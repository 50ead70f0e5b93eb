"""Where a robot is, when one Gaussian is not enough: a few pose filters, each for a narrow range of yaws.

A robot whose yaw is uncertain by a third of a radian is somewhere on an arc. A Gaussian about the arc's middle, updated
by signals of motes, soon converges to places beside the arc. An uncertain yaw is therefore split, and each part is
filtered separately. Received signals decide between the parts. This is a Gaussian sum filter (Sorenson and Alspach,
*Recursive Bayesian estimation using Gaussian sums*, Automatica 1971). Without signals, or while walls hold the yaw, it
is one pose filter.
"""

import math

import numpy as np

from robrain.algorithms.localization.pose_filter import (
    GATE,
    SCALE,
    SHADOWS,
    MeasurementUpdate,
    PoseFilter,
    closest_pair,
)
from robrain.algorithms.localization.rssi_ranging import RssiSample
from robrain.algorithms.numeric.elementary_functions import exp, log
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.numeric.small_linear_algebra import dot, quadratic_form
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad

SPLIT_RAD = 0.15
"""A filter with a larger uncertainty of the yaw than this is split; chosen, as are the other figures here."""
PARTS_MAX = 9
SPLIT_APART, SPLIT_WEIGHT = 1.0575, 0.2252
"""Three Gaussians in place of one: DeMars, Bishop, Jah, *Entropy-based approach for uncertainty propagation of
nonlinear dynamical systems*, J. Guidance, Control and Dynamics 2013, table 1; narrowed so that the variance is kept."""
MERGE_LOSS = 0.002
"""Parts are merged that lose less by it (Kullback and Leibler's divergence, nat)."""
WEIGHT_MIN = 1e-4
"""Parts less likely than this are dropped."""


class PoseMixture:
    """Estimates a pose in the arena frame, as `PoseFilter` does.

    Args:
        filter: the one to begin with; it belongs to the mixture from now on.
        parts_max: how many there may be.

    """

    def __init__(self, filter: PoseFilter, parts_max: int = PARTS_MAX) -> None:
        self._parts = [filter]
        self._weights = [1.0]
        self._parts_max = parts_max

    def __len__(self) -> int:
        return len(self._parts)

    @property
    def pose(self) -> Pose2D:
        """The mean, T_arena_robot."""
        if len(self._parts) == 1:
            return self._parts[0].pose
        x_m, y_m, yaw_rad = self._mean()[:3].tolist()
        return Pose2D(x_m, y_m, wrap_angle_rad(yaw_rad))

    @property
    def covariance(self) -> Floats:
        """(3, 3) of x, y, yaw: m², m·rad, rad²; of all parts about their mean."""
        if len(self._parts) == 1:
            return self._parts[0].covariance
        mean = self._mean()[:3]
        total = np.zeros((3, 3))
        for part, weight in zip(self._parts, self._weights, strict=True):
            off = part.mean[:3] - mean
            total += weight * (part.covariance + np.outer(off, off))
        return total

    @property
    def covariances(self) -> list[float]:
        """(9,) `covariance`, row by row."""
        if len(self._parts) == 1:
            return self._parts[0].covariances
        values: list[float] = self.covariance.ravel().tolist()
        return values

    @property
    def biases(self) -> tuple[float, float, float]:
        """Scale error, curve (rad/m) and turn error (rad/rad) of the odometry."""
        if len(self._parts) == 1:
            return self._parts[0].biases
        scale, curve, turn = self._mean()[SCALE:].tolist()
        return scale, curve, turn

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the place along the worst direction."""
        if len(self._parts) == 1:
            return self._parts[0].sigma_m
        (p_xx, p_xy), (_, p_yy) = self.covariance[:2, :2].tolist()
        return math.sqrt(0.5 * (p_xx + p_yy) + math.hypot(0.5 * (p_xx - p_yy), p_xy))

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the yaw."""
        return self._parts[0].sigma_rad if len(self._parts) == 1 else math.sqrt(self.covariance[2, 2])

    def move(self, displacement: Twist2D) -> None:
        """The odometry measured this displacement since the last call, as `odometry.chord` gives it."""
        for part in self._parts:
            part.move(displacement)

    def receive(self, sample: RssiSample, gate: float = GATE, *, map_variance_m2: float = 0.0) -> MeasurementUpdate:
        """Update with the strength of a mote's signal; arguments and result are those of `PoseFilter`.

        A signal that a part's gate rejects counts against the part as much as a signal at the gate's limit.
        """
        self._split()
        received = [part.receive(sample, gate, map_variance_m2=map_variance_m2) for part in self._parts]
        if len(received) == 1:
            return received[0]
        innovations_db = np.array([each.innovation_db for each in received])
        variances_db2 = np.array([each.variance_db2 for each in received])
        weights = np.array(self._weights)
        mean_db = dot(weights, innovations_db)
        variance_db2 = dot(weights, variances_db2 + innovations_db**2) - mean_db**2
        nis = np.minimum([each.nis for each in received], gate)
        self._weigh(-0.5 * (nis + log(variances_db2)))
        return MeasurementUpdate(
            mean_db**2 / variance_db2, any(each.is_accepted for each in received), mean_db, variance_db2
        )

    def correct(self, row: tuple[float, float, float], innovation: float, variance: float) -> float:
        """Update with a measurement of `row` · (x, y, yaw) that differs by `innovation` from the mean; its NIS."""
        if len(self._parts) == 1:
            return self._parts[0].correct(row, innovation, variance)
        mean = self._mean()[:3]
        direction = np.array(row)
        nis = innovation**2 / (quadratic_form(self.covariance, direction) + variance)
        logs = []
        for part in self._parts:
            own = innovation - dot(part.mean[:3] - mean, direction)
            expected = quadratic_form(part.covariance, direction) + variance
            logs.append(-0.5 * (own**2 / expected + math.log(expected)))
            part.correct(row, own, variance)
        self._weigh(np.array(logs))
        return nis

    def correct_along(self, rows: Floats, offsets_m: Floats, variances: Floats) -> None:
        """Update with measurements of orthogonal `rows` (n, 3) · (x, y, yaw), `offsets_m` from the mean."""
        if len(self._parts) == 1:
            self._parts[0].correct_along(rows, offsets_m, variances)
            return
        start = self.pose
        for row, offset_m, variance in zip(rows.tolist(), offsets_m.tolist(), variances.tolist(), strict=True):
            now = self.pose
            turned_rad = wrap_angle_rad(now.yaw_rad - start.yaw_rad)
            done_m = row[0] * (now.x_m - start.x_m) + row[1] * (now.y_m - start.y_m) + row[2] * turned_rad
            self.correct((row[0], row[1], row[2]), offset_m - done_m, variance)

    def at_least(self, variances: tuple[float, float, float]) -> None:
        """Raise the variances of x, y (m²) and yaw (rad²) to at least these in every part."""
        for part in self._parts:
            part.at_least(variances)

    def add(self, variances: tuple[float, float, float]) -> None:
        """Add to the variances of x, y (m²) and yaw (rad²)."""
        for part in self._parts:
            part.add(variances)

    def doubt(self, sigma_m: float, sigma_rad: float) -> None:
        """Add uncertainty: the robot may have been moved. It is one filter again."""
        self._merge_all()
        self._parts[0].doubt(sigma_m, sigma_rad)

    def shift(self, T_new_old: Pose2D) -> None:
        """Move the estimate: the pose becomes `T_new_old` · pose."""
        for part in self._parts:
            part.shift(T_new_old)

    def place(self, pose: Pose2D, covariance: Floats) -> None:
        """Begin again at a pose with a (3, 3) covariance; the estimated errors of the odometry are kept."""
        self._merge_all()
        self._parts[0].place(pose, covariance)

    def _mean(self) -> Floats:
        if len(self._parts) == 1:
            return self._parts[0].mean
        total = np.zeros(SHADOWS)
        for part, weight in zip(self._parts, self._weights, strict=True):
            total += weight * part.mean
        return total

    def _split(self) -> None:
        for index in range(len(self._parts)):
            part, weight = self._parts[index], self._weights[index]
            if part.sigma_rad > SPLIT_RAD and self._parts_max > 2:
                if len(self._parts) + 2 > self._parts_max:
                    return
                self._parts += part.split(SPLIT_APART, SPLIT_WEIGHT)
                self._weights[index] = (1.0 - 2.0 * SPLIT_WEIGHT) * weight
                self._weights += [SPLIT_WEIGHT * weight] * 2

    def _weigh(self, logs: Floats) -> None:
        """Multiply the weights by likelihoods, drop unlikely parts, merge similar ones."""
        weights = np.array(self._weights) * exp(logs - logs.max())
        weights /= weights.sum()
        kept = [index for index, weight in enumerate(weights.tolist()) if weight > WEIGHT_MIN]
        self._parts = [self._parts[index] for index in kept]
        self._weights = (weights[kept] / weights[kept].sum()).tolist()
        while len(self._parts) > 1:
            poses = np.array([part.mean[:3] for part in self._parts])
            covariances = np.array([part.covariance for part in self._parts])
            first, second, loss = closest_pair(poses, covariances, np.array(self._weights))
            if loss > MERGE_LOSS and len(self._parts) + 2 <= self._parts_max:
                break
            self._merge(first, second)

    def _merge(self, first: int, second: int) -> None:
        other, weight = self._parts.pop(second), self._weights.pop(second)
        self._weights[first] += weight
        self._parts[first].absorb(other, weight / self._weights[first])

    def _merge_all(self) -> None:
        while len(self._parts) > 1:
            self._merge(0, len(self._parts) - 1)
