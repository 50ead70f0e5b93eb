"""Relocalises a robot by the motes that it receives along a stretch of odometry, without a known start.

A grid over place and yaw is followed by a finer grid around the best cell. The result is the posterior of a flat prior,
with each mote's shadowing integrated out in closed form. Markov localisation on a grid, as in Thrun, Burgard, Fox,
*Probabilistic Robotics*, section 8.2.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.localization.odometry import moved_along
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.numeric.elementary_functions import exp
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Pose2D, Twist2D

MARGIN_M = 6.0
"""The search for the robot extends this far around the received motes."""
CELL_M = 0.75
COARSE_MAX = 40
"""Cells a side; larger fields get larger cells."""
YAWS = 36
FINE, FINER = 11, 2
"""Cells a side of the fine grid, and yaws; and how often it is made finer."""
ELSEWHERE_M, ELSEWHERE_RAD = 2.0, 0.55
"""Nearer than this is not another place."""
CERTAIN = 0.95
"""Share of the probability that must lie about one place."""

RECORDS = 64
RECORDS_TO_FIND = 24
MOTES_TO_FIND = 4
PATH_TO_FIND_M = 2.0
"""A robot that has not moved cannot determine its yaw from signals."""


class Signals(NamedTuple):
    """Signals received on a stretch of path.

    N signals of M motes.
    """

    places: Floats
    """(N, 2) places of the robot at reception, in its own frame *now*: metres, x ahead."""
    motes: NDArray[np.int64]
    """(N,) indices into the following."""
    mote_places: Floats
    """(M, 2) arena frame, metres."""
    rssi_dbm: Floats
    """(N,)."""


def find_robot(signals: Signals, path_loss: PathLoss) -> tuple[Pose2D, Floats] | None:
    """Present pose of the robot, and the (3, 3) covariance; None if several places are possible."""
    low, high = _field(signals)
    cell_m = max(CELL_M, float((high - low).max()) / COARSE_MAX)
    xs = np.arange(low[0] + cell_m / 2, high[0], cell_m)
    ys = np.arange(low[1] + cell_m / 2, high[1], cell_m)
    yaws = np.linspace(-math.pi, math.pi, YAWS, endpoint=False)
    coarse = _posterior(xs, ys, yaws, signals, path_loss)
    i, j, k = np.unravel_index(int(coarse.argmax()), coarse.shape)
    about = coarse[max(i - 3, 0) : i + 4, max(j - 3, 0) : j + 4][:, :, (np.arange(k - 3, k + 4)) % YAWS]
    if float(about.sum()) < CERTAIN:
        return None
    mean, covariance = _moments(xs[max(i - 3, 0) : i + 4], ys[max(j - 3, 0) : j + 4], yaws[k], math.tau / YAWS, about)
    # Finer, over three standard deviations, and over gaps of the coarser cells.
    hidden = np.array((1.5 * cell_m, 1.5 * cell_m, math.tau / YAWS))
    for _ in range(FINER):
        spans = 3.0 * np.sqrt(np.diag(covariance)) + hidden
        fine_xs, fine_ys, fine_yaws = (
            np.linspace(at - span, at + span, FINE) for at, span in zip(mean.tolist(), spans.tolist(), strict=True)
        )
        fine = _posterior(fine_xs, fine_ys, fine_yaws, signals, path_loss)
        mean, covariance = _moments(
            fine_xs, fine_ys, float(fine_yaws[FINE // 2]), float(fine_yaws[1] - fine_yaws[0]), fine
        )
        hidden = 2.0 * spans / (FINE - 1)
        covariance += np.diag(hidden**2 / 12)
    return Pose2D(float(mean[0]), float(mean[1]), math.remainder(float(mean[2]), math.tau)), covariance


def better_elsewhere(here: Pose2D, signals: Signals, path_loss: PathLoss) -> float:
    """By how much a pose elsewhere explains the signals better than any about `here`: a logarithm of likelihoods.

    Elsewhere is farther off than `ELSEWHERE_M` or `ELSEWHERE_RAD`. Twice the result is that of a likelihood ratio test
    of three degrees of freedom (S. S. Wilks, 1938), taken at many places.
    """
    low, high = _field(signals)
    cell_m = max(2 * CELL_M, float((high - low).max()) / (COARSE_MAX // 2))
    xs, ys = np.arange(low[0] + cell_m / 2, high[0], cell_m), np.arange(low[1] + cell_m / 2, high[1], cell_m)
    turns = np.linspace(-math.pi, math.pi, YAWS // 3, endpoint=False)
    logs = _logs(xs, ys, here.yaw_rad + turns, signals, path_loss)
    near = np.array((-0.5, 0.0, 0.5))
    about = _logs(
        here.x_m + ELSEWHERE_M * near,
        here.y_m + ELSEWHERE_M * near,
        here.yaw_rad + ELSEWHERE_RAD * near,
        signals,
        path_loss,
    )
    is_far = (np.hypot(xs[:, None] - here.x_m, ys - here.y_m) > ELSEWHERE_M)[:, :, None] | (abs(turns) > ELSEWHERE_RAD)
    return float(logs[is_far].max() - max(about.max(), logs[~is_far].max(initial=-math.inf)))


def _field(signals: Signals) -> tuple[Floats, Floats]:
    """Lowest and highest x and y of the search."""
    return signals.mote_places.min(axis=0) - MARGIN_M, signals.mote_places.max(axis=0) + MARGIN_M


def _posterior(xs: Floats, ys: Floats, yaws: Floats, signals: Signals, path_loss: PathLoss) -> Floats:
    logs = _logs(xs, ys, yaws, signals, path_loss)
    weights = exp(logs - logs.max())
    weights /= weights.sum()
    return weights


def _logs(xs: Floats, ys: Floats, yaws: Floats, signals: Signals, path_loss: PathLoss) -> Floats:
    logs: Floats = _log_likelihood(
        xs,
        ys,
        yaws,
        *signals,
        path_loss.rssi_at_1_m_dbm,
        path_loss.db_per_e_fold,
        path_loss.shadowing_db**2,
        path_loss.fading_db**2,
    )
    return logs


def _moments(xs: Floats, ys: Floats, middle_rad: float, step_rad: float, weights: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance of (x, y, yaw), where the last axis is `step_rad` apart about `middle_rad`."""
    count = weights.shape[2]
    yaws = middle_rad + step_rad * (np.arange(count) - count // 2)
    mean, covariance = np.zeros(3), np.zeros((3, 3))
    _add_moments(xs, ys, yaws, np.ascontiguousarray(weights), float(weights.sum()), mean, covariance)
    return mean, covariance


@njit(cache=True, nogil=True)
def _add_moments(
    xs: Floats, ys: Floats, yaws: Floats, weights: Floats, total: float, mean: Floats, covariance: Floats
) -> None:
    for i in range(xs.shape[0]):
        for j in range(ys.shape[0]):
            for k in range(yaws.shape[0]):
                share = weights[i, j, k] / total
                mean[0] += share * xs[i]
                mean[1] += share * ys[j]
                mean[2] += share * yaws[k]
    off = np.empty(3)
    for i in range(xs.shape[0]):
        for j in range(ys.shape[0]):
            for k in range(yaws.shape[0]):
                share = weights[i, j, k] / total
                off[0], off[1], off[2] = xs[i] - mean[0], ys[j] - mean[1], yaws[k] - mean[2]
                for row in range(3):
                    for column in range(3):
                        covariance[row, column] += share * off[row] * off[column]


@njit(cache=True, nogil=True)
def _log_likelihood(
    xs: Floats,
    ys: Floats,
    yaws: Floats,
    places: Floats,
    motes: NDArray[np.int64],
    mote_places: Floats,
    rssi_dbm: Floats,
    at_1_m_dbm: float,
    db_per_fold: float,
    shadow_variance: float,
    variance: float,
) -> Floats:
    """(X, Y, A): of all signals, were the robot at each place and yaw."""
    count = mote_places.shape[0]
    logs = np.empty((xs.shape[0], ys.shape[0], yaws.shape[0]))
    sums, squares = np.empty(count), np.empty(count)
    received = np.zeros(count)
    for n in range(motes.shape[0]):
        received[motes[n]] += 1
    turned = np.empty(places.shape)
    for a in range(yaws.shape[0]):
        cos, sin = math.cos(yaws[a]), math.sin(yaws[a])
        for n in range(places.shape[0]):
            turned[n, 0] = cos * places[n, 0] - sin * places[n, 1] - mote_places[motes[n], 0]
            turned[n, 1] = sin * places[n, 0] + cos * places[n, 1] - mote_places[motes[n], 1]
        for i in range(xs.shape[0]):
            for j in range(ys.shape[0]):
                sums[:] = 0.0
                squares[:] = 0.0
                for n in range(places.shape[0]):
                    dx, dy = xs[i] + turned[n, 0], ys[j] + turned[n, 1]
                    loss_db = 0.5 * db_per_fold * math.log(max(dx * dx + dy * dy, 0.01))
                    off = rssi_dbm[n] - at_1_m_dbm + loss_db
                    sums[motes[n]] += off
                    squares[motes[n]] += off * off
                total = 0.0
                # A shared shadowing of variance s beside independent r: Sherman and Morrison's inverse of r·1 + s·11ᵀ.
                for m in range(count):
                    common = shadow_variance / (variance + received[m] * shadow_variance)
                    total -= 0.5 * (squares[m] - common * sums[m] * sums[m]) / variance
                logs[i, j, a] = total
    return logs


class RecentSignals:
    """Tracks the path by odometry, in its own frame, and keeps the last `RECORDS` signals on it."""

    def __init__(self) -> None:
        self.has_received = False
        """Whether there ever was one."""
        self._records: deque[tuple[RssiSample, Pose2D]] = deque(maxlen=RECORDS)
        self._reckoned = Pose2D(0.0, 0.0, 0.0)

    def __len__(self) -> int:
        return len(self._records)

    def move(self, displacement: Twist2D) -> None:
        """The robot has moved so, as `odometry.chord` gives it, its errors taken off."""
        self._reckoned = moved_along(self._reckoned, displacement)

    def receive(self, sample: RssiSample) -> None:
        """Handle a received signal of a mote."""
        self._records.append((sample, self._reckoned))
        self.has_received = True

    def forget(self) -> None:
        """Discard all signals, because they may belong to another place."""
        self._records.clear()

    def can_find(self, path_m: float) -> bool:
        """Whether the signals suffice for a search, after this length of path."""
        names = {sample.mote for sample, _ in self._records}
        return len(self._records) >= RECORDS_TO_FIND and len(names) >= MOTES_TO_FIND and path_m > PATH_TO_FIND_M

    def seen_from_here(self) -> Signals:
        """All of them, with the places in the frame of the robot as it is now."""
        samples = [sample for sample, _ in self._records]
        places = {sample.mote: sample.place for sample in samples}
        index = {mote: number for number, mote in enumerate(places)}
        back = self._reckoned.inverse()
        seen_from = [back.compose(at) for _, at in self._records]
        return Signals(
            np.array([(at.x_m, at.y_m) for at in seen_from]),
            np.array([index[sample.mote] for sample in samples], np.int64),
            np.array([(place.x_m, place.y_m) for place in places.values()]),
            np.array([sample.rssi_dbm for sample in samples], np.float64),
        )

    def nis(self, here: Pose2D, path_loss: PathLoss) -> float:
        """Mean normalised squared error of the signals for a robot here; 0 if there are none."""
        if not self._records:
            return 0.0
        places, motes, mote_places, rssi_dbm = self.seen_from_here()
        cos, sin = math.cos(here.yaw_rad), math.sin(here.yaw_rad)
        x_m = here.x_m + cos * places[:, 0] - sin * places[:, 1]
        y_m = here.y_m + sin * places[:, 0] + cos * places[:, 1]
        distances_m = np.hypot(x_m - mote_places[motes, 0], y_m - mote_places[motes, 1])
        off_db: Floats = rssi_dbm - [path_loss.mean_dbm(distance_m) for distance_m in distances_m.tolist()]
        return float(np.mean(off_db**2)) / (path_loss.shadowing_db**2 + path_loss.fading_db**2)
