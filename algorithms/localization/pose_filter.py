"""Where a robot is, with its odometry's errors and each mote's shadowing estimated along: a sigma-point Kalman filter.

Measurements are few and their errors last: a wheel that is too small stays so, a wall between a mote and the robot
stays there. Taken as noise, such errors would be averaged away on paper and the filter would come to believe in its own
figures. They are states instead.
"""

import copy
import math

import msgspec
import numpy as np
from numba import njit

from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad
from robrain.protocol.model.ranges import NotNegative

X, Y, YAW, SCALE, CURVE, TURN = 0, 1, 2, 3, 4, 5
SHADOWS = 6
"""Index of the first mote's shadowing."""
ROOT_3 = math.sqrt(3.0)


@njit(cache=True, nogil=True)
def predict(
    mean: Floats,
    covariance: Floats,
    size: int,
    forward_m: float,
    left_m: float,
    turn_rad: float,
    variances: Floats,
    shadow_variance: float,
    decorrelation_m: float,
) -> None:
    """Predict the state after a displacement that the odometry measured, in the robot's frame.

    `variances` (6,) holds m² per m of path, rad² per m and rad² per rad of turning. It also holds the random walk of
    scale, curve and turn error per m of path.
    """
    scale = 1.0 + mean[SCALE]
    turned_rad = turn_rad * (1.0 + mean[TURN]) + mean[CURVE] * forward_m
    cos = math.cos(mean[YAW] + 0.5 * turned_rad)
    sin = math.sin(mean[YAW] + 0.5 * turned_rad)
    unit_x, unit_y = cos * forward_m - sin * left_m, sin * forward_m + cos * left_m
    dx, dy = scale * unit_x, scale * unit_y
    mean[X] += dx
    mean[Y] += dy
    mean[YAW] += turned_rad

    # F = 1 + E, where E has three rows; first the rows of F·P, then the columns of (F·P)·Fᵀ.
    half_curve, half_turn = 0.5 * forward_m, 0.5 * turn_rad
    for j in range(size):
        yaw, curve, turn = covariance[YAW, j], covariance[CURVE, j], covariance[TURN, j]
        aside = yaw + half_curve * curve + half_turn * turn
        covariance[X, j] += unit_x * covariance[SCALE, j] - dy * aside
        covariance[Y, j] += unit_y * covariance[SCALE, j] + dx * aside
        covariance[YAW, j] += forward_m * curve + turn_rad * turn
    for i in range(size):
        yaw, curve, turn = covariance[i, YAW], covariance[i, CURVE], covariance[i, TURN]
        aside = yaw + half_curve * curve + half_turn * turn
        covariance[i, X] += unit_x * covariance[i, SCALE] - dy * aside
        covariance[i, Y] += unit_y * covariance[i, SCALE] + dx * aside
        covariance[i, YAW] += forward_m * curve + turn_rad * turn
    # Rounding differs by the order of the sums.
    for i in range(3):
        for j in range(size):
            covariance[i, j] = covariance[j, i] = 0.5 * (covariance[i, j] + covariance[j, i])

    path_m = math.hypot(forward_m, left_m)
    covariance[X, X] += variances[0] * path_m
    covariance[Y, Y] += variances[0] * path_m
    covariance[YAW, YAW] += variances[1] * path_m + variances[2] * abs(turn_rad)
    for k in range(3):
        covariance[SCALE + k, SCALE + k] += variances[3 + k] * path_m
    if path_m > 0.0:
        keep = math.exp(-path_m / decorrelation_m)
        for i in range(SHADOWS, size):
            mean[i] *= keep
            for j in range(size):
                covariance[i, j] *= keep
                covariance[j, i] *= keep
            covariance[i, i] += (1.0 - keep * keep) * shadow_variance


@njit(cache=True, nogil=True)
def update(
    mean: Floats,
    covariance: Floats,
    size: int,
    third: int,
    row_x: float,
    row_y: float,
    row_third: float,
    innovation: float,
    variance: float,
) -> float:
    """Update with a scalar measurement of x, y and one more state; returns the expected variance of its innovation.

    The Joseph form, (1 − K·H)·P·(1 − K·H)ᵀ + K·R·Kᵀ, keeps the covariance symmetric and positive definite for any gain.
    Sources: Bucy and Joseph 1968; Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and
    Navigation*, section 5.2.3.
    """
    along = np.empty(size)  # P·Hᵀ
    for i in range(size):
        along[i] = row_x * covariance[i, X] + row_y * covariance[i, Y] + row_third * covariance[i, third]
    expected: float = row_x * along[X] + row_y * along[Y] + row_third * along[third] + variance
    gain = along / expected
    for i in range(size):
        mean[i] += gain[i] * innovation
        for j in range(size):
            covariance[i, j] -= gain[i] * along[j]
    for i in range(size):
        # (1 − K·H)·P·Hᵀ, from the rows that are done.
        along[i] = row_x * covariance[i, X] + row_y * covariance[i, Y] + row_third * covariance[i, third]
    for i in range(size):
        for j in range(size):
            covariance[i, j] += gain[i] * variance * gain[j] - along[i] * gain[j]
    for i in range(size):
        for j in range(i):
            covariance[i, j] = covariance[j, i] = 0.5 * (covariance[i, j] + covariance[j, i])
    return expected


@njit(cache=True, nogil=True)
def _wrapped(angle_rad: float) -> float:
    """`geometry.wrap_angle_rad`."""
    wrapped: float = np.fmod(angle_rad + math.pi, 2.0 * math.pi)
    if wrapped <= 0.0:
        wrapped += 2.0 * math.pi
    return wrapped - math.pi


@njit(cache=True, nogil=True)
def update_along(
    mean: Floats, covariance: Floats, size: int, rows: Floats, offsets_m: Floats, variances: Floats
) -> None:
    """Update with measurements of rows (n, 3) of x, y, yaw, one by one; all offsets (n,) are from the start."""
    start_x, start_y, start_yaw = mean[X], mean[Y], _wrapped(mean[YAW])
    for n in range(rows.shape[0]):
        turned_rad = _wrapped(_wrapped(mean[YAW]) - start_yaw)
        done_m = rows[n, 0] * (mean[X] - start_x) + rows[n, 1] * (mean[Y] - start_y) + rows[n, 2] * turned_rad
        left_m = offsets_m[n] - done_m
        update(mean, covariance, size, YAW, rows[n, 0], rows[n, 1], rows[n, 2], left_m, variances[n])


@njit(cache=True, nogil=True)
def _linearise(
    x_m: float,
    y_m: float,
    p_xx: float,
    p_xy: float,
    p_yy: float,
    mote_x_m: float,
    mote_y_m: float,
    at_1_m: float,
    db_per_fold: float,
) -> tuple[float, float, float, float]:
    """Slope in x and y, value at (x, y), and the variance that the straight line leaves unexplained.

    Statistical linear regression over the 3 × 3 Gauss–Hermite points of the Gaussian.
    """
    low_xx = math.sqrt(p_xx)
    low_yx = p_xy / low_xx
    low_yy = math.sqrt(max(p_yy - low_yx * low_yx, 1e-12))
    middle, by_first, by_second, square = 0.0, 0.0, 0.0, 0.0
    for a in range(-1, 2):
        for b in range(-1, 2):
            weight = (2.0 / 3.0 if a == 0 else 1.0 / 6.0) * (2.0 / 3.0 if b == 0 else 1.0 / 6.0)
            first, second = ROOT_3 * a, ROOT_3 * b
            x, y = x_m + low_xx * first, y_m + low_yx * first + low_yy * second
            value = at_1_m - db_per_fold * math.log(max(math.hypot(x - mote_x_m, y - mote_y_m), 0.1))
            middle += weight * value
            square += weight * value * value
            by_first += weight * first * value
            by_second += weight * second * value
    # In the whitened coordinates the regression's slopes are the two covariances; then back through L⁻¹.
    slope_y = by_second / low_yy
    slope_x = (by_first - low_yx * slope_y) / low_xx
    unexplained = max(square - middle * middle - by_first * by_first - by_second * by_second, 0.0)
    return slope_x, slope_y, middle, unexplained


@njit(cache=True, nogil=True)
def update_by_signal(
    mean: Floats,
    covariance: Floats,
    size: int,
    slot: int,
    mote_x_m: float,
    mote_y_m: float,
    rssi_dbm: float,
    at_1_m_dbm: float,
    db_per_fold: float,
    variance: float,
    gate: float,
) -> tuple[float, float, float]:
    """Update with a signal strength unless the gate refuses it; returns NIS, innovation, its variance.

    Measured: a repetition of the linearisation about the posterior gains nothing with these points.
    """
    p_xx, p_xy, p_yy = covariance[X, X], covariance[X, Y], covariance[Y, Y]
    p_xs, p_ys, p_ss = covariance[X, slot], covariance[Y, slot], covariance[slot, slot]
    row_x, row_y, value, unexplained = _linearise(
        mean[X], mean[Y], p_xx, p_xy, p_yy, mote_x_m, mote_y_m, at_1_m_dbm, db_per_fold
    )
    noise = variance + unexplained
    innovation = rssi_dbm - (value + mean[slot])
    along_x = row_x * p_xx + row_y * p_xy + p_xs
    along_y = row_x * p_xy + row_y * p_yy + p_ys
    along_s = row_x * p_xs + row_y * p_ys + p_ss
    expected = row_x * along_x + row_y * along_y + along_s + noise
    nis = innovation * innovation / expected
    if nis <= gate:
        update(mean, covariance, size, slot, row_x, row_y, 1.0, innovation, noise)
    return nis, innovation, expected


@njit(cache=True, nogil=True)
def _log_determinant(a: float, b: float, c: float, d: float, e: float, f: float) -> float:
    """Of the symmetric matrix with rows (a, b, c), (b, d, e), (c, e, f)."""
    return math.log(max(a * (d * f - e * e) - b * (b * f - e * c) + c * (b * e - d * c), 1e-300))


@njit(cache=True, nogil=True)
def closest_pair(poses: Floats, covariances: Floats, weights: Floats) -> tuple[int, int, float]:
    """The two of a Gaussian mixture whose merging loses least, and a bound of what it loses.

    `poses` (K, 3), `covariances` (K, 3, 3), `weights` (K,). The bound is on the Kullback–Leibler divergence between
    the mixtures before and after: A. R. Runnalls, *Kullback–Leibler approach to Gaussian mixture reduction*, IEEE
    Trans. Aerospace and Electronic Systems 2007, equation 21.
    """
    best_i, best_j, best = 0, 1, math.inf
    own = np.empty(weights.shape[0])
    for i in range(weights.shape[0]):
        p = covariances[i]
        own[i] = weights[i] * _log_determinant(p[0, 0], p[0, 1], p[0, 2], p[1, 1], p[1, 2], p[2, 2])
    for i in range(weights.shape[0]):
        for j in range(i + 1, weights.shape[0]):
            both = weights[i] + weights[j]
            first, second = weights[i] / both, weights[j] / both
            off = poses[i] - poses[j]
            p = first * covariances[i] + second * covariances[j]
            for row in range(3):
                for column in range(3):
                    p[row, column] += first * second * off[row] * off[column]
            merged = _log_determinant(p[0, 0], p[0, 1], p[0, 2], p[1, 1], p[1, 2], p[2, 2])
            lost = 0.5 * (both * merged - own[i] - own[j])
            if lost < best:
                best_i, best_j, best = i, j, lost
    return best_i, best_j, best


GATE = 10.83
"""99.9 % of a chi-square variable of one degree of freedom."""


class DriftModel(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How odometry goes wrong: noise, and errors that stay. Standard deviations; all chosen for three omni wheels.

    True turning = turn·(1 + turn error) + curve·forward path; true path = path·(1 + scale error). A wheel that is 1 %
    smaller than another makes a Robertino-like base curve by 0.02 rad/m.
    """

    sigma_m_per_sqrt_m: NotNegative = 0.01
    sigma_rad_per_sqrt_m: NotNegative = 0.005
    sigma_rad_per_sqrt_rad: NotNegative = 0.01
    scale: NotNegative = 0.03
    curve_rad_per_m: NotNegative = 0.03
    turn: NotNegative = 0.03
    scale_per_sqrt_m: NotNegative = 0.0005
    """Random walk of the scale error: floors and loads change."""
    curve_rad_per_m_per_sqrt_m: NotNegative = 0.0003
    turn_per_sqrt_m: NotNegative = 0.0005


class MeasurementUpdate(msgspec.Struct, frozen=True):
    """The filter's result for a measurement."""

    nis: float
    """Normalised innovation squared: about 1 if the filter is as good as it believes."""
    is_accepted: bool
    innovation_db: float = 0.0
    variance_db2: float = 1.0
    """Of the innovation, as the filter expected it."""


class PoseFilter:
    """Estimates a pose in the arena frame.

    Args:
        start: estimated start pose of the robot.
        sigma_m: standard deviation of that place in x and in y.
        sigma_rad: standard deviation of that yaw.
        drift: error model of the odometry.
        path_loss: relation between signal strength and distance.
        motes: number of motes whose shadowing is kept; a new mote replaces the one received longest ago.

    """

    def __init__(
        self,
        start: Pose2D,
        sigma_m: float,
        sigma_rad: float,
        drift: DriftModel,
        path_loss: PathLoss,
        *,
        motes: int = 32,
    ) -> None:
        self.drift = drift
        self.path_loss = path_loss
        self._capacity = SHADOWS + motes
        self._size = SHADOWS
        self._mean = np.zeros(self._capacity)
        self._covariance = np.zeros((self._capacity, self._capacity))
        self._slots: dict[str, int] = {}
        """Slot of each mote, the one received longest ago first."""
        walks = (
            drift.sigma_m_per_sqrt_m,
            drift.sigma_rad_per_sqrt_m,
            drift.sigma_rad_per_sqrt_rad,
            drift.scale_per_sqrt_m,
            drift.curve_rad_per_m_per_sqrt_m,
            drift.turn_per_sqrt_m,
        )
        self._walks = np.square(walks)
        variances = np.zeros(self._capacity)
        variances[SCALE:SHADOWS] = np.square((drift.scale, drift.curve_rad_per_m, drift.turn))
        # A state of zero variance could not be corrected and would make the covariance singular.
        np.fill_diagonal(self._covariance, variances + 1e-12)
        self.place(start, np.diag(np.square((max(sigma_m, 1e-4), max(sigma_m, 1e-4), max(sigma_rad, 1e-4)))))

    @property
    def pose(self) -> Pose2D:
        """The estimate of T_arena_robot."""
        x_m, y_m, yaw_rad = self._mean[:3].tolist()
        return Pose2D(x_m, y_m, yaw_rad if -math.pi < yaw_rad <= math.pi else wrap_angle_rad(yaw_rad))

    @property
    def mean(self) -> Floats:
        """(6,) x, y, yaw (not wrapped), and the odometry's errors; a copy."""
        return self._mean[:SHADOWS].copy()

    @property
    def covariance(self) -> Floats:
        """(3, 3) of x, y, yaw: m², m·rad, rad²; a copy."""
        return self._covariance[:3, :3].copy()

    @property
    def covariances(self) -> list[float]:
        """(9,) `covariance`, row by row."""
        values: list[float] = self._covariance[:3, :3].ravel().tolist()
        return values

    @property
    def whole_covariance(self) -> Floats:
        """(n, n) of all states; a copy."""
        return self._covariance[: self._size, : self._size].copy()

    @property
    def biases(self) -> tuple[float, float, float]:
        """Scale error, curve (rad/m) and turn error (rad/rad) of the odometry."""
        scale, curve, turn = self._mean[SCALE:SHADOWS].tolist()
        return scale, curve, turn

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the place along the worst direction."""
        (p_xx, p_xy), (_, p_yy) = self._covariance[:2, :2].tolist()
        return math.sqrt(0.5 * (p_xx + p_yy) + math.hypot(0.5 * (p_xx - p_yy), p_xy))

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the yaw."""
        return math.sqrt(self._covariance[2, 2])

    def move(self, displacement: Twist2D) -> None:
        """The odometry measured this displacement since the last call, as `odometry.chord` gives it."""
        predict(
            self._mean,
            self._covariance,
            self._size,
            displacement.forward_m_s,
            displacement.left_m_s,
            displacement.yaw_rad_s,
            self._walks,
            self.path_loss.shadowing_db**2,
            self.path_loss.decorrelation_m,
        )

    def receive(self, sample: RssiSample, gate: float = GATE, *, map_variance_m2: float = 0.0) -> MeasurementUpdate:
        """Update with the strength of a mote's signal, unless its normalised innovation squared exceeds the gate.

        `map_variance_m2` is that of the map that the robot goes by, for each axis, and not in the filter's covariance.
        """
        mean_x_m, mean_y_m = self._mean[0], self._mean[1]
        square_m2 = (mean_x_m - sample.place.x_m) ** 2 + (mean_y_m - sample.place.y_m) ** 2
        map_db2 = self.path_loss.db_per_e_fold**2 * map_variance_m2 / max(square_m2, 1.0)
        slot = self._slot(sample.mote)  # may add a state
        nis, innovation_db, variance_db2 = update_by_signal(
            self._mean,
            self._covariance,
            self._size,
            slot,
            sample.place.x_m,
            sample.place.y_m,
            float(sample.rssi_dbm),  # numba would compile once more for a whole number
            self.path_loss.rssi_at_1_m_dbm,
            self.path_loss.db_per_e_fold,
            self.path_loss.fading_db**2 + map_db2,
            gate,
        )
        return MeasurementUpdate(nis, nis <= gate, innovation_db, variance_db2)

    def correct(self, row: tuple[float, float, float], innovation: float, variance: float) -> float:
        """Update with a measurement of `row` · (x, y, yaw), `innovation` off the estimate; returns its NIS."""
        expected: float = update(
            self._mean, self._covariance, self._size, YAW, row[0], row[1], row[2], innovation, variance
        )
        return innovation**2 / expected

    def correct_along(self, rows: Floats, offsets_m: Floats, variances: Floats) -> None:
        """Update with measurements of `rows` (n, 3) · (x, y, yaw), `offsets_m` (n,) off the estimate as it is before.

        The rows are orthogonal but the filter's errors are correlated, so that each also changes the residual of the
        next.
        """
        update_along(self._mean, self._covariance, self._size, rows, offsets_m, variances)

    def at_least(self, variances: tuple[float, float, float]) -> None:
        """Raise the variances of x, y (m²) and yaw (rad²) to at least these, for errors that all measurements share."""
        for index, variance in enumerate(variances):
            lacking = variance - self._covariance[index, index]
            if lacking > 0:
                self._covariance[index, index] += lacking

    def add(self, variances: tuple[float, float, float]) -> None:
        """Add to the variances of x, y (m²) and yaw (rad²)."""
        for index, variance in enumerate(variances):
            self._covariance[index, index] += variance

    def doubt(self, sigma_m: float, sigma_rad: float) -> None:
        """Add uncertainty: the robot may have been moved. Shadowings are as unknown again as at the beginning."""
        self.add((sigma_m**2, sigma_m**2, sigma_rad**2))
        self._forget_motes()

    def place(self, pose: Pose2D, covariance: Floats) -> None:
        """Begin again at a pose with a (3, 3) covariance; the estimated errors of the odometry are kept."""
        self._mean[:3] = pose.x_m, pose.y_m, pose.yaw_rad
        self._covariance[:3, :] = 0.0
        self._covariance[:, :3] = 0.0
        self._covariance[:3, :3] = covariance
        self._forget_motes()

    def shift(self, T_new_old: Pose2D) -> None:
        """Move the estimate: the pose becomes `T_new_old` · pose."""
        cos, sin = math.cos(T_new_old.yaw_rad), math.sin(T_new_old.yaw_rad)
        x_m, y_m = self._mean[0], self._mean[1]
        self._mean[0] = T_new_old.x_m + cos * x_m - sin * y_m
        self._mean[1] = T_new_old.y_m + sin * x_m + cos * y_m
        self._mean[2] += T_new_old.yaw_rad
        size = self._size
        for rows in (self._covariance[:2, :size], self._covariance[:size, :2].T):
            x, y = rows[0].copy(), rows[1].copy()
            rows[0], rows[1] = cos * x - sin * y, sin * x + cos * y

    def split(self, apart: float, weight: float) -> tuple["PoseFilter", "PoseFilter"]:
        """Make this the middle one of three narrower filters, mean and covariance of all together as before.

        The others lie `apart` standard deviations of the yaw to either side and have this weight each; correlated
        states move along.
        """
        along = self._covariance[: self._size, YAW] / self.sigma_rad
        self._covariance[: self._size, : self._size] -= 2.0 * weight * apart**2 * np.outer(along, along)
        sides = self._copy(), self._copy()
        for side, sign in zip(sides, (-1.0, 1.0), strict=True):
            side._mean[: self._size] += sign * apart * along
        return sides

    def absorb(self, other: "PoseFilter", share: float) -> None:
        """Become the Gaussian that has mean and covariance of both, where the other counts for `share` of the whole.

        The other must have received the same motes.
        """
        size = self._size
        off = other._mean[:size] - self._mean[:size]
        own = self._covariance[:size, :size]
        own += share * (other._covariance[:size, :size] - own) + share * (1.0 - share) * np.outer(off, off)
        self._mean[:size] += share * off

    def _copy(self) -> "PoseFilter":
        other = copy.copy(self)
        other._mean, other._covariance, other._slots = self._mean.copy(), self._covariance.copy(), self._slots.copy()
        return other

    def _forget_motes(self) -> None:
        for slot in range(SHADOWS, self._size):
            self._open(slot)
        self._size = SHADOWS
        self._slots.clear()

    def _slot(self, mote: str) -> int:
        slot = self._slots.pop(mote, None)
        if slot is None:
            if self._size < self._capacity:
                slot = self._size
                self._size += 1
            else:
                slot = self._slots.pop(next(iter(self._slots)))
            self._open(slot)
        self._slots[mote] = slot
        return slot

    def _open(self, slot: int) -> None:
        self._mean[slot] = 0.0
        self._covariance[slot, :] = 0.0
        self._covariance[:, slot] = 0.0
        self._covariance[slot, slot] = self.path_loss.shadowing_db**2 + 1e-12
