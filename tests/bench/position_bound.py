"""The posterior Cramér–Rao bound of the localisation benchmark: how well any estimator could do on the same data.

Tichavský, Muravchik, Nehorai: *Posterior Cramér–Rao bounds for discrete-time nonlinear filtering*, IEEE Trans. Signal
Processing 1998: J(k+1) = (Q + F·J(k)⁻¹·Fᵀ)⁻¹ + Hᵀ·R⁻¹·H, with F and H taken at the true states, here of one given way.
It is written with covariances, because the odometry's errors do not move and their Q is 0. Nothing of the filter is
used.
"""

import math

import numpy as np

from robrain.algorithms.localization.pose_filter import DriftModel
from tests.bench.localisation_world import SIGMA_DB, START_SIGMA_M, START_SIGMA_RAD, TRUE_LOSS, Drive


def position_bound_m(drive: Drive, drift: DriftModel, static_share: float) -> float:
    """Root of the bound on the mean squared error of the place, over the whole way, metres.

    States: x, y, yaw, scale, curve, turn error, and the static shadowing of each mote.
    """
    size = 6 + len(drive.motes)
    static_variance = static_share * SIGMA_DB**2
    variance = (1.0 - static_share) * SIGMA_DB**2
    priors = (START_SIGMA_M, START_SIGMA_M, START_SIGMA_RAD, drift.scale, drift.curve_rad_per_m, drift.turn)
    covariance = np.diag(np.concatenate((np.square(priors), np.full(size - 6, static_variance))))
    scale, curve, turn = drive.biases
    total = 0.0
    transition = np.eye(size)
    for step, (forward_m, left_m, turned_rad) in enumerate(drive.measured.tolist()):
        middle_rad = drive.true[step, 2] + 0.5 * (turned_rad * (1.0 + turn) + curve * forward_m)
        cos, sin = math.cos(middle_rad), math.sin(middle_rad)
        x_m, y_m = cos * forward_m - sin * left_m, sin * forward_m + cos * left_m
        dx_m, dy_m = (1.0 + scale) * x_m, (1.0 + scale) * y_m
        transition[0, 2:6] = -dy_m, x_m, -dy_m * forward_m / 2, -dy_m * turned_rad / 2
        transition[1, 2:6] = dx_m, y_m, dx_m * forward_m / 2, dx_m * turned_rad / 2
        transition[2, 4:6] = forward_m, turned_rad
        covariance = transition @ covariance @ transition.T
        path_m = math.hypot(forward_m, left_m)
        covariance[0, 0] += drift.sigma_m_per_sqrt_m**2 * path_m
        covariance[1, 1] += drift.sigma_m_per_sqrt_m**2 * path_m
        covariance[2, 2] += drift.sigma_rad_per_sqrt_m**2 * path_m + drift.sigma_rad_per_sqrt_rad**2 * abs(turned_rad)
        for mote, _ in drive.heard[step]:
            place = drive.motes[mote]
            off_x_m, off_y_m = drive.true[step + 1, 0] - place.x_m, drive.true[step + 1, 1] - place.y_m
            square = max(off_x_m**2 + off_y_m**2, 0.01)
            row = np.zeros(size)
            row[0], row[1] = -TRUE_LOSS.db_per_e_fold * off_x_m / square, -TRUE_LOSS.db_per_e_fold * off_y_m / square
            row[6 + mote] = 1.0
            along = covariance @ row
            covariance -= np.outer(along, along) / (row @ along + variance)
        total += covariance[0, 0] + covariance[1, 1]
    return math.sqrt(total / len(drive.measured))
