"""The arithmetic of the pose filter: prediction, and scalar updates in Joseph form.

States: x, y (m), yaw (rad), the odometry's scale error, its curve (rad/m) and its turn error (rad/rad), then one
shadowing (dB) for each mote. `mean` is (capacity,), `covariance` (capacity, capacity), C-contiguous; the first `size`
entries count. All functions work in place.
"""

import math

import numpy as np
from numba import njit

from robrain.algorithms.numeric.kernel_array import Floats

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
    """Move on by a displacement that the odometry measured, in the robot's frame.

    `variances` (6,): m² per m of way, rad² per m, rad² per rad of turning; and the random walk of scale, curve and
    turn error per m of way.
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

    way_m = math.hypot(forward_m, left_m)
    covariance[X, X] += variances[0] * way_m
    covariance[Y, Y] += variances[0] * way_m
    covariance[YAW, YAW] += variances[1] * way_m + variances[2] * abs(turn_rad)
    for k in range(3):
        covariance[SCALE + k, SCALE + k] += variances[3 + k] * way_m
    if way_m > 0.0:
        keep = math.exp(-way_m / decorrelation_m)
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

    Joseph form, (1 − K·H)·P·(1 − K·H)ᵀ + K·R·Kᵀ, which keeps the covariance symmetric and positive definite for
    any gain (Bucy and Joseph 1968; Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and
    Navigation*, section 5.2.3).
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
def _strength(x_m: float, y_m: float, mote_x_m: float, mote_y_m: float, at_1_m: float, db_per_fold: float) -> float:
    return at_1_m - db_per_fold * math.log(max(math.hypot(x_m - mote_x_m, y_m - mote_y_m), 0.1))


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
    spread: float,
) -> tuple[float, float, float, float]:
    """Slope in x and y, value at (x, y), and the variance that the straight line leaves unexplained.

    With a spread: statistical linear regression over the 3 × 3 Gauss–Hermite points of the Gaussian. Without: tangent.
    """
    if spread == 0.0:
        dx, dy = x_m - mote_x_m, y_m - mote_y_m
        square = max(dx * dx + dy * dy, 0.01)
        value = _strength(x_m, y_m, mote_x_m, mote_y_m, at_1_m, db_per_fold)
        return -db_per_fold * dx / square, -db_per_fold * dy / square, value, 0.0
    low_xx = math.sqrt(p_xx)
    low_yx = p_xy / low_xx
    low_yy = math.sqrt(max(p_yy - low_yx * low_yx, 1e-12))
    middle, by_first, by_second, square = 0.0, 0.0, 0.0, 0.0
    for a in range(-1, 2):
        for b in range(-1, 2):
            weight = (2.0 / 3.0 if a == 0 else 1.0 / 6.0) * (2.0 / 3.0 if b == 0 else 1.0 / 6.0)
            first, second = spread * a, spread * b
            value = _strength(
                x_m + low_xx * first, y_m + low_yx * first + low_yy * second, mote_x_m, mote_y_m, at_1_m, db_per_fold
            )
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
def hear(
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
    spread: float,
    relinearisations: int,
) -> tuple[float, float, float]:
    """Take in a signal strength unless the gate refuses it; normalised innovation squared, innovation, its variance.

    The linearisation is repeated about the posterior (posterior linearisation filter: García-Fernández, Svensson,
    Morelande, Särkkä, IEEE Trans. Signal Processing 2015), always starting from the prior.
    """
    x_m, y_m = mean[X], mean[Y]
    p_xx, p_xy, p_yy = covariance[X, X], covariance[X, Y], covariance[Y, Y]
    p_xs, p_ys, p_ss = covariance[X, slot], covariance[Y, slot], covariance[slot, slot]
    nis, first, first_variance = 0.0, 0.0, 0.0
    row_x, row_y, innovation, noise = 0.0, 0.0, 0.0, variance
    at_x, at_y, at_xx, at_xy, at_yy = x_m, y_m, p_xx, p_xy, p_yy
    for turn in range(relinearisations + 1):
        row_x, row_y, value, unexplained = _linearise(
            at_x, at_y, at_xx, at_xy, at_yy, mote_x_m, mote_y_m, at_1_m_dbm, db_per_fold, spread
        )
        noise = variance + unexplained
        innovation = rssi_dbm - (value + row_x * (x_m - at_x) + row_y * (y_m - at_y) + mean[slot])
        along_x = row_x * p_xx + row_y * p_xy + p_xs
        along_y = row_x * p_xy + row_y * p_yy + p_ys
        along_s = row_x * p_xs + row_y * p_ys + p_ss
        expected = row_x * along_x + row_y * along_y + along_s + noise
        if turn == 0:
            nis, first, first_variance = innovation * innovation / expected, innovation, expected
            if nis > gate:
                return nis, first, first_variance
        at_x, at_y = x_m + along_x / expected * innovation, y_m + along_y / expected * innovation
        at_xx = max(p_xx - along_x * along_x / expected, 1e-9)
        at_xy = p_xy - along_x * along_y / expected
        at_yy = max(p_yy - along_y * along_y / expected, 1e-9)
    update(mean, covariance, size, slot, row_x, row_y, 1.0, innovation, noise)
    return nis, first, first_variance


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
