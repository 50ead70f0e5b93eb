"""Where a robot is, with its odometry's errors and each mote's shadowing estimated along: a sigma-point Kalman filter.

Measurements are few and their errors last: a wheel that is too small stays so, a wall between a mote and the robot
stays there. Taken as noise, such errors would be averaged away on paper and the filter would come to believe in its own
figures. They are states instead.
"""

import copy
import math

import msgspec
import numpy as np

from robrain.algorithms.localization import pose_filter_kernels as kernels
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad
from robrain.protocol.model.ranges import check_not_negative

SPREAD = kernels.ROOT_3
"""Of the Gauss–Hermite points; 0 linearises at the mean alone, as an (iterated) extended Kalman filter does."""
RELINEARISATIONS = 0
"""Measured in tests/bench/localisation.py: with the points above, more of them gain nothing."""
GATE = 10.83
"""99.9 % of a chi-square variable of one degree of freedom."""


class DriftModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How odometry goes wrong: noise, and errors that stay. Standard deviations; all chosen for three omni wheels.

    True turning = turn·(1 + turn error) + curve·forward way; true way = way·(1 + scale error). A wheel that is 1 %
    smaller than another makes a Robertino-like base curve by 0.02 rad/m.
    """

    sigma_m_per_sqrt_m: float = 0.01
    sigma_rad_per_sqrt_m: float = 0.005
    sigma_rad_per_sqrt_rad: float = 0.01
    scale: float = 0.03
    curve_rad_per_m: float = 0.03
    turn: float = 0.03
    scale_per_sqrt_m: float = 0.0005
    """Random walk of the scale error: floors and loads change."""
    curve_rad_per_m_per_sqrt_m: float = 0.0003
    turn_per_sqrt_m: float = 0.0005

    def __post_init__(self) -> None:
        check_not_negative(self, *self.__struct_fields__, finite=True)


class MeasurementUpdate(msgspec.Struct, frozen=True):
    """What the filter made of a measurement."""

    nis: float
    """Normalised innovation squared: about 1 if the filter is as good as it believes."""
    is_taken: bool
    innovation_db: float = 0.0
    variance_db2: float = 1.0
    """Of the innovation, as the filter expected it."""


class PoseFilter:
    """Estimates a pose in the arena frame.

    Args:
        start: where the robot is believed to be.
        sigma_m: standard deviation of that place in x and in y.
        sigma_rad: standard deviation of that yaw.
        drift: how the odometry goes wrong.
        path_loss: what signals say of distances.
        motes: for how many motes a shadowing is kept; the one that was heard longest ago makes place for a new one.
        spread: see SPREAD.
        relinearisations: how often a measurement is linearised anew.

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
        spread: float = SPREAD,
        relinearisations: int = RELINEARISATIONS,
    ) -> None:
        self.drift = drift
        self.path_loss = path_loss
        self._capacity = kernels.SHADOWS + motes
        self._size = kernels.SHADOWS
        self._mean = np.zeros(self._capacity)
        self._covariance = np.zeros((self._capacity, self._capacity))
        self._slots: dict[str, int] = {}
        """Slot of each mote, the one heard longest ago first."""
        self._spread = float(spread)
        self._relinearisations = relinearisations
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
        variances[kernels.SCALE : kernels.SHADOWS] = np.square((drift.scale, drift.curve_rad_per_m, drift.turn))
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
        return self._mean[: kernels.SHADOWS].copy()

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
        scale, curve, turn = self._mean[kernels.SCALE : kernels.SHADOWS].tolist()
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
        kernels.predict(
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

    def hear(self, sample: RssiSample, gate: float = GATE, *, map_variance_m2: float = 0.0) -> MeasurementUpdate:
        """Take in the strength of a mote's signal, unless its normalised innovation squared exceeds the gate.

        `map_variance_m2` is that of the map that the robot goes by, for each axis, and not in the filter's covariance.
        """
        mean_x_m, mean_y_m = self._mean[0], self._mean[1]
        square_m2 = (mean_x_m - sample.place.x_m) ** 2 + (mean_y_m - sample.place.y_m) ** 2
        map_db2 = self.path_loss.db_per_e_fold**2 * map_variance_m2 / max(square_m2, 1.0)
        slot = self._slot(sample.mote)  # may add a state
        nis, innovation_db, variance_db2 = kernels.hear(
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
            self._spread,
            self._relinearisations,
        )
        return MeasurementUpdate(nis, nis <= gate, innovation_db, variance_db2)

    def correct(self, row: tuple[float, float, float], innovation: float, variance: float) -> float:
        """Update with a measurement of `row` · (x, y, yaw), `innovation` off the estimate; returns its NIS."""
        expected: float = kernels.update(
            self._mean, self._covariance, self._size, kernels.YAW, row[0], row[1], row[2], innovation, variance
        )
        return innovation**2 / expected

    def correct_along(self, rows: Floats, offsets_m: Floats, variances: Floats) -> None:
        """Update with measurements of `rows` (n, 3) · (x, y, yaw), `offsets_m` (n,) off the estimate as it is before.

        The rows are orthogonal but the filter's errors are correlated, so that each corrects what is left of the next.
        """
        kernels.update_along(self._mean, self._covariance, self._size, rows, offsets_m, variances)

    def at_least(self, variances: tuple[float, float, float]) -> None:
        """Let x, y (m²) and yaw (rad²) be no surer than this: for errors that measurements share, so none can tell."""
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
        """Begin again at a pose with a (3, 3) covariance; what is known of the odometry's errors is kept."""
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

        The others lie `apart` standard deviations of the yaw to either side and have this weight each; what depends on
        the yaw goes along.
        """
        along = self._covariance[: self._size, kernels.YAW] / self.sigma_rad
        self._covariance[: self._size, : self._size] -= 2.0 * weight * apart**2 * np.outer(along, along)
        sides = self._copy(), self._copy()
        for side, sign in zip(sides, (-1.0, 1.0), strict=True):
            side._mean[: self._size] += sign * apart * along
        return sides

    def absorb(self, other: "PoseFilter", share: float) -> None:
        """Become the Gaussian that has mean and covariance of both, where the other counts for `share` of the whole.

        The other must have heard the same motes.
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
        for slot in range(kernels.SHADOWS, self._size):
            self._open(slot)
        self._size = kernels.SHADOWS
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
