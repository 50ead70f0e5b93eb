"""Localises a robot: the pose filter, its divergence monitor, and the relocalisation after a divergence."""

import math
from collections import deque
from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from robrain.algorithms.localization.mote_relocalisation import RecentSignals, better_elsewhere, find_robot
from robrain.algorithms.localization.pose_filter import GATE, DriftModel, PoseFilter
from robrain.algorithms.localization.pose_mixture import PoseMixture
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.localization.scan_match import ScanFit, search_scan
from robrain.algorithms.localization.surface_match import COMPARED_MIN, agreement, match_surface
from robrain.algorithms.mapping.local_map import NO_DRIFT, NONE, Drift, LocalMap
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.numeric.small_linear_algebra import innovation_squared
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import IDENTITY, Pose2D, Twist2D, wrap_angle_rad
from robrain.protocol.model.grid_geometry import GridGeometry


class DivergenceSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits for innovations.

    Raises ValueError for a window below 2.

    The mean normalised innovation squared (NIS) of `window` measurements is that of a chi-square variable divided by
    the window. Source: Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*, section
    5.4.2. For a window of 32 it exceeds 2.6 once in a million times for a correct estimate.
    """

    window: Annotated[int, Meta(ge=2)] = 32
    nis_max: float = 2.6
    refused_max: float = 0.3
    """Share of the window that the gate may refuse."""
    misfits_max: int = 8
    """Number of consecutive scans that may match the map badly."""
    fit_min: float = 0.65
    """Share of a scan's beams that have to end at the map's walls."""


class DivergenceMonitor:
    """Counts bad measurements, and gives the reason why the estimate cannot be right.

    Args:
        spec: when that is.
        gate: innovations squared count up to this; larger ones count as refused.

    """

    def __init__(self, spec: DivergenceSpec, gate: float) -> None:
        self.spec = spec
        self.refused = 0
        """Measurements that the gate has refused, since the beginning."""
        self._gate = gate
        self._nis: deque[float] = deque(maxlen=spec.window)
        self.misfits = 0
        """Number of scans in a row that lie badly on the map."""

    @property
    def mean_nis(self) -> float:
        """Of the window, with refused ones at the gate; 0 before the first measurement."""
        return sum(self._nis) / len(self._nis) if self._nis else 0.0

    def check_signal(self, nis: float) -> str:
        """A measurement had this NIS; why the estimate cannot be right, or nothing."""
        self.refused += nis > self._gate
        self._nis.append(min(nis, self._gate))
        if len(self._nis) < self.spec.window:
            return ""
        gate = self._gate
        refused = len([each for each in self._nis if each >= gate])
        if refused > self.spec.refused_max * self.spec.window:
            return f"{refused} of the last {self.spec.window} signals of motes contradict the estimated pose"
        if self.mean_nis > self.spec.nis_max:
            return (
                f"signals of motes are off by {self.mean_nis:.1f} times the variance expected, "
                f"over the last {self.spec.window}"
            )
        return ""

    def check_scan(self, fit: float) -> str:
        """A scan lay so well on the map; why the estimate cannot be right, or nothing."""
        self.misfits = self.misfits + 1 if fit < self.spec.fit_min else 0
        if self.misfits >= self.spec.misfits_max:
            return f"{self.misfits} scans in a row do not fit the map, the last one by {fit:.0%} of its beams"
        return ""

    def reset(self) -> None:
        """Reset all counts except that of the refused ones."""
        self._nis.clear()
        self.misfits = 0


COMPARE_EVERY = 24
"""Number of signals after which the estimate is compared with all other places."""
ELSEWHERE_MAX = 8.0
"""Logarithm of the likelihood by which another place may be better; chosen: no false alarm in the benchmark."""
FIND_EVERY = 8
"""Number of further signals after which the search is repeated."""
FOUND_SIGMA_M, FOUND_SIGMA_RAD = 1.5, 0.5
"""A result with a larger uncertainty than this is discarded."""
SEARCH_WITHIN_RAD = 0.6
TURN_M_PER_RAD = 0.3
"""Path length that shows as much new evidence as a turn of one radian."""
MATCH_M, MATCH_SIGMA_M = 0.02, 0.05
"""Distance between two corrections by walls of a robot with this small uncertainty. The place of each wall in its cell
is the same unknown for all scans from one spot. More scans from there do not average it away."""
DOUBT_PATH_M = 1.0
WALL_BEAMS = 20.0
"""Number of beams on one wall that share one error, because the wall is drawn in one row of cells; chosen."""
SCAN_GATES = (10.83, 13.82, 16.27)
"""99.9 % of a chi-square variable, by the number of directions in which walls hold the robot."""
REFUSED_SIGMA_M, REFUSED_SIGMA_RAD = 0.1, 0.05
"""Uncertainty that a scan adds if it places the robot where it cannot be; chosen. The wheels may be worse than
specified, or may have slipped. A later scan with the same result is then believed."""
JUMP_M, JUMP_RAD, JUMP_SIGMAS = 0.3, 0.35, 3.0
"""A scan that fits this far from the pose by the wheels, after scans that did not fit, shows another place; chosen."""
ADAPTATION, NIS_MAX = 0.1, 5.0
"""Rate by which one match changes the share of doubt, and the largest normalised innovation that counts; chosen."""
START_AGREES = 0.6
"""Share of a scan's beams that must agree with the team's map, or the robot is not at its configured start; chosen."""
SIGNALS_TO_AGREE = 12
"""A lost robot that receives motes needs at least this many signals before a place is believed."""
SIGNALS_NIS_MAX = 2.0
"""A place is not believed if the last signals of motes are off by more, in units of their variance."""
OWN_SIGMA_M, OWN_SIGMA_RAD = 0.02, 0.01
"""Standard deviations of a robot's pose where it begins its own map frame."""


class LocaliserSpec(msgspec.Struct, frozen=True, kw_only=True):
    """Sensor parameters of a localiser."""

    drift: DriftModel = DriftModel()
    path_loss: PathLoss = PathLoss()
    watch: DivergenceSpec = DivergenceSpec()
    motes_max: int = 32
    slack_cells: float = 0.0
    """The place of a wall within its cell is unknown: offsets below this many cells count as zero. Slack keeps a good
    odometry unchanged, but a bad odometry then drags the map along."""
    wall_sigma_m: float = 0.01
    """Standard deviation of a match beyond that. An error that a match does not correct is drawn into the map, and the
    next match keeps it. With a larger value, the map turns with the odometry."""
    floor_m: float = 0.03
    """Least uncertainty of the place on the map by matching; only a better odometry goes below it …"""
    floor_rad: float = 0.005
    """… and the same for the yaw."""
    least_share: float = 1.0
    """Least share of doubts and floors that counts: below 1 for a base with better odometry than they are made for."""
    doubt_m_per_m: float = 0.05
    """Error of the odometry between two matches beyond the filter's states: metres per metre …"""
    doubt_rad_per_m: float = 0.1
    """… and radians per metre. Each wheel has its own error, so the curve differs by direction of travel."""
    step_m: float = 0.01
    """Standard deviation, metres, of the error that matching leaves when new walls are mapped …"""
    step_rad: float = 0.002
    """… and that of its yaw, radians."""
    search_m: float = 0.2
    search_rad: float = 0.06
    """A place or a yaw with a larger uncertainty than this is searched for before it is refined."""
    search_within_m: float = 2.5
    maps: bool = True
    """Whether the robot maps by itself. A lost robot that maps continues in its own map frame."""
    lost_sigma_m: float = 5.0
    """Added to the place's uncertainty when the estimate of a robot that does not map has diverged."""


class Estimate(msgspec.Struct, frozen=True):
    """State of a `Localiser`."""

    pose: Pose2D
    covariances: tuple[float, ...]
    drift: Drift
    local_sigma_m: float
    """Standard deviation of the place on the robot's own map; in the arena while no walls hold it."""


class Localiser:
    """Estimates a robot's pose in the arena frame, and reports when it cannot.

    Args:
        start: assumed start pose of the robot.
        sigma_m: standard deviation of its x and of its y.
        sigma_rad: standard deviation of its yaw.
        spec: the robot's sensors.

    """

    def __init__(self, start: Pose2D, sigma_m: float, sigma_rad: float, spec: LocaliserSpec) -> None:
        self.spec = spec
        self.filter = PoseMixture(
            PoseFilter(start, sigma_m, sigma_rad, spec.drift, spec.path_loss, motes=spec.motes_max)
        )
        self.watch = DivergenceMonitor(spec.watch, GATE)
        self.lost = ""
        """Reason why the robot does not know its place in the arena; empty while it does."""
        self.beginnings = 0
        """Number of times that the estimate was reset, to another place or to another frame."""
        self.arena_fix: tuple[Pose2D, Floats] | None = None
        """T_arena_robot and its covariance, as found from motes while the robot is lost and maps in its own frame."""
        self.fits = True
        """Whether the last scan matched the robot's own map."""
        self._map_drift = NO_DRIFT
        """Variances of the pose from which the walls that scans are matched to were first seen."""
        self._trajectory = 0
        self._of_map = NONE
        """Variances of the place in the arena of the walls that hold the robot; none while no walls do."""
        self._share = spec.least_share
        """Share of doubts and floors that counts, as the innovations of scans have it."""
        self._matched_path_m = 0.0
        self._seen_path_m = 0.0
        self.driven_m = 0.0
        """Metres driven since the estimate began or the robot was lost; turns count `TURN_M_PER_RAD`."""
        self._fitted_sigma_m = 0.0
        """Standard deviation of the place at the last scan that fitted."""
        self._T_now_wheels = IDENTITY
        """Motion of the sensor by all corrections since that scan, in the frame of the robot's own map."""
        self._signals = RecentSignals()
        self._since_tried = 0

    @property
    def pose(self) -> Pose2D:
        """The estimate of T_arena_robot."""
        return self.filter.pose

    @property
    def covariances(self) -> tuple[float, ...]:
        """(3, 3) of x, y, yaw in the arena frame, row by row: m², m·rad, rad². Errors of the robot's map count."""
        xx, xy, xt, yx, yy, yt, tx, ty, tt = self.filter.covariances
        x, y, yaw = self._of_map
        return (xx + x, xy, xt, yx, yy + y, yt, tx, ty, tt + yaw)

    @property
    def covariance(self) -> Floats:
        """`covariances` as an array (3, 3)."""
        return np.array(self.covariances).reshape(3, 3)

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the place in the arena frame, no less than along the worst direction."""
        return math.sqrt(self.filter.sigma_m**2 + max(self._of_map[:2]))

    def move(self, displacement: Twist2D) -> None:
        """The odometry measured this displacement since the last call, as `odometry.chord` gives it."""
        self.filter.move(displacement)
        scale, curve, turn = self.filter.biases
        forward_m, left_m = displacement.forward_m_s, displacement.left_m_s
        turned_rad = displacement.yaw_rad_s * (1.0 + turn) + curve * forward_m
        self._signals.move(Twist2D((1.0 + scale) * forward_m, (1.0 + scale) * left_m, turned_rad))
        self.driven_m += math.hypot(forward_m, left_m) + TURN_M_PER_RAD * abs(turned_rad)

    def receive(self, sample: RssiSample) -> None:
        """Handle a signal of a mote with a known place."""
        self._signals.receive(sample)
        if self.lost:
            self._since_tried += 1
            if self._since_tried >= FIND_EVERY:
                self._since_tried = 0
                self._find_by_motes()
            return
        reason = self.watch.check_signal(self.filter.receive(sample, map_variance_m2=max(self._of_map[:2])).nis)
        self._since_tried += 1
        if not reason and self._since_tried >= COMPARE_EVERY and self._signals.can_find(self.driven_m):
            self._since_tried = 0
            odds = better_elsewhere(self.pose, self._signals.seen_from_here(), self.spec.path_loss)
            if odds > ELSEWHERE_MAX:
                reason = f"the last {len(self._signals)} signals of motes speak for another place (by {odds:.0f} nat)"
        if reason:
            self.lose(reason)

    def shift(self, T_new_old: Pose2D) -> None:
        """Move the estimate with the map, which loop closures have moved: the pose becomes `T_new_old` · pose."""
        self.filter.shift(T_new_old)

    def see(self, points: Floats, map: LocalMap, T_robot_sensor: Pose2D = IDENTITY) -> ScanFit:
        """Match a scan to the robot's own map and correct the estimate.

        `points` (K, 2) are the ends of its beams, see `beam_ends`, without those at other robots. `T_robot_sensor` is
        the pose of the sensor at the time of the scan, relative to the robot's current pose.
        """
        if map.trajectory != self._trajectory:
            self._trajectory = map.trajectory
            self._map_drift = NO_DRIFT
        believed = guess = map.T_arena_local.inverse().compose(self.pose).compose(T_robot_sensor)
        if self.filter.sigma_m > self.spec.search_m or self.filter.sigma_rad > self.spec.search_rad:
            found = self._search(map.grid.log_odds, map.grid.geometry, guess, points)
            guess = guess if found is None else found
        fit, walls_drift = match_surface(map.grid, guess, points)
        misfits = self.watch.misfits
        if not misfits:
            self._fitted_sigma_m = self.filter.sigma_m
        path_m = min(self.driven_m - self._seen_path_m, DOUBT_PATH_M)
        self._seen_path_m = self.driven_m
        doubt_m2, doubt_rad2 = (
            (self._share * each * path_m) ** 2 for each in (self.spec.doubt_m_per_m, self.spec.doubt_rad_per_m)
        )
        self.filter.add((doubt_m2, doubt_m2, doubt_rad2))
        is_new = self.driven_m - self._matched_path_m > MATCH_M or self.filter.sigma_m > MATCH_SIGMA_M
        if fit.directions and is_new:
            self._go_by(walls_drift)
        is_believed = not is_new or self._correct(fit, believed, guess, map)
        if not is_believed:
            self.filter.add((REFUSED_SIGMA_M**2, REFUSED_SIGMA_M**2, REFUSED_SIGMA_RAD**2))
        self._reckon_map(map)
        self.fits = is_believed and (not fit.beams or fit.fit >= self.spec.watch.fit_min)
        reason = self.watch.check_scan(fit.fit if is_believed else 0.0) if fit.beams else ""
        if not reason and fit.beams and (misfits or not self.fits):
            if not misfits:
                self._T_now_wheels = IDENTITY
            reason = self._jumped(believed, map.T_arena_local.inverse().compose(self.pose).compose(T_robot_sensor))
        if reason:
            self.lose(reason)
        return fit

    def _jumped(self, believed: Pose2D, now: Pose2D) -> str:
        """Why the robot cannot be where a scan fits that came after some that did not; empty if it may be.

        Slip of the wheels builds up slowly, and each scan corrects it. A scan that fits only far from the pose by the
        wheels means that the robot has been carried to a similar place.

        Args:
            believed: T_local_sensor before the scan corrected it.
            now: the same after it.

        """
        self._T_now_wheels = now.compose(believed.inverse()).compose(self._T_now_wheels)
        if not self.fits:
            return ""
        by_wheels = self._T_now_wheels.inverse().compose(now)
        off_m, off_rad = by_wheels.distance_m(now), abs(by_wheels.inverse().compose(now).yaw_rad)
        if off_m < max(JUMP_M, JUMP_SIGMAS * self._fitted_sigma_m) and off_rad < JUMP_RAD:
            return ""
        return f"the walls fit {off_m:.2f} m and {math.degrees(off_rad):.0f}° off where the wheels have it"

    @property
    def drift(self) -> Drift:
        """Variances of the robot's pose relative to where its own map began: position (m² per axis) and yaw (rad²)."""
        return self._drift(self.filter.covariances)

    def estimate(self) -> Estimate:
        """The whole estimate, computed at once."""
        own = self.filter.covariances
        xx, xy, xt, yx, yy, yt, tx, ty, tt = own
        x, y, yaw = self._of_map
        return Estimate(
            self.pose,
            (xx + x, xy, xt, yx, yy + y, yt, tx, ty, tt + yaw),
            self._drift(own),
            math.sqrt(0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)),
        )

    def _drift(self, covariances: Sequence[float]) -> Drift:
        spec = self.spec
        own_m2, own_rad2 = 0.5 * (covariances[0] + covariances[4]), covariances[8]
        beyond_m2, beyond_rad2 = max(own_m2 - spec.floor_m**2, 0.0), max(own_rad2 - spec.floor_rad**2, 0.0)
        m2, rad2 = self._map_drift
        return m2 + beyond_m2 + min(spec.step_m**2, own_m2), rad2 + beyond_rad2 + min(spec.step_rad**2, own_rad2)

    def _go_by(self, walls: Drift) -> None:
        """Note that the scan was matched to walls that were mapped when the robot's pose had these variances.

        A match gives the robot's pose relative to the walls. If the pose was uncertain when they were mapped, the walls
        have the same error, and no match can reveal it. The exact solution keeps the poses from which the map was made
        as states, as SLAM does; the pose graph does so for whole submaps.
        """
        m2, rad2 = (max(now - then, 0.0) for now, then in zip(self._map_drift, walls, strict=True))
        self.filter.add((m2, m2, rad2))
        self._map_drift = walls

    def _reckon_map(self, map: LocalMap) -> None:
        """Compute the variances of the matched walls' position in the arena."""
        anchor = map.T_arena_local.compose(map.anchor)
        dx_m, dy_m = self.pose.x_m - anchor.x_m, self.pose.y_m - anchor.y_m
        m2, rad2 = (max(now - then, 0.0) for now, then in zip(self._map_drift, map.drift, strict=True))
        x, y, yaw = map.variances
        x_yaw, y_yaw = map.with_yaw
        # An error of yaw at the anchor, or of the walls since, moves the robot, which is some metres away from it.
        x += max(dy_m * (dy_m * (yaw + rad2) - 2.0 * x_yaw), -x)
        y += max(dx_m * (dx_m * (yaw + rad2) + 2.0 * y_yaw), -y)
        self._of_map = x + m2, y + m2, yaw + rad2

    def may_be_at(self, pose: Pose2D) -> bool:
        """Whether the received signals of motes, if any, allow the robot to be at a pose of the arena frame."""
        signals = self._signals
        if not signals.has_received:
            return True
        return len(signals) >= SIGNALS_TO_AGREE and signals.nis(pose, self.spec.path_loss) < SIGNALS_NIS_MAX

    def check_start(
        self,
        log_odds: NDArray[np.int8],
        geometry: GridGeometry,
        points: Floats,
        T_robot_sensor: Pose2D = IDENTITY,
    ) -> bool:
        """Compare a scan with a map of other robots, to check that the robot is at its configured start.

        If the map shows the place and the scan contradicts it, the robot is lost. `points` and `T_robot_sensor` are
        those of `see`; False if the map does not show enough of the place.
        """
        if self.lost or not len(points):
            return True
        sensor = self.pose.compose(T_robot_sensor)
        share, compared = agreement(log_odds, geometry, sensor, points)
        if compared < COMPARED_MIN * len(points):
            return False
        if share < START_AGREES:
            self.lose(f"only {share:.0%} of what the lidar sees at the start is as on the map of the others")
        return True

    def _correct(self, fit: ScanFit, believed: Pose2D, guess: Pose2D, map: LocalMap) -> bool:
        """Update by the `fit` of a scan about `guess`, the filter's pose of the sensor; False if it is impossible."""
        if not fit.directions:
            return True
        ahead = (guess.x_m - believed.x_m, guess.y_m - believed.y_m, wrap_angle_rad(guess.yaw_rad - believed.yaw_rad))
        spec = self.spec
        slack_m = map.grid.geometry.resolution_m * spec.slack_cells
        of_beam_m2, cos, sin = spec.wall_sigma_m**2, 1.0, 0.0
        if map.T_arena_local.yaw_rad:
            cos, sin = math.cos(map.T_arena_local.yaw_rad), math.sin(map.T_arena_local.yaw_rad)
        rows, offsets_m, variances = [], [], []
        for held in fit.directions:
            x, y, yaw = held.row
            offset_m = x * ahead[0] + y * ahead[1] + yaw * ahead[2] + held.offset_m
            offsets_m.append(math.copysign(max(abs(offset_m) - slack_m, 0.0), offset_m))
            rows.append((cos * x - sin * y, sin * x + cos * y, yaw))
            variances.append(of_beam_m2 * (1.0 + WALL_BEAMS / held.information))
        along, off_m, noise = np.array(rows), np.array(offsets_m), np.array(variances)
        floors, before = (spec.floor_m**2, spec.floor_m**2, spec.floor_rad**2), self.filter.covariance
        shared = before + np.diag(np.maximum(floors - before.diagonal(), 0.0))
        if innovation_squared(along, shared, off_m, noise) > SCAN_GATES[len(rows) - 1]:
            return False
        self._adapt(innovation_squared(along, before, off_m, noise) / len(rows))
        self.filter.correct_along(along, off_m, noise)
        self.filter.at_least(tuple(np.clip(before.diagonal(), self._share**2 * np.array(floors), floors).tolist()))
        self._matched_path_m = self.driven_m
        return True

    def _adapt(self, nis: float) -> None:
        """Match the covariance to the innovations: more uncertainty while they exceed the expectation, otherwise less.

        Innovation-based adaptive estimation of the process noise (Mohamed and Schwarz, *Adaptive Kalman filtering for
        INS/GPS*, Journal of Geodesy 1999), of one factor.
        """
        share = self._share * math.exp(ADAPTATION * (min(nis, NIS_MAX) - 1.0))
        self._share = min(max(share, self.spec.least_share), 1.0)

    def lose(self, reason: str) -> None:
        """Declare the estimate invalid.

        A robot that maps begins its own map frame, in which it keeps its last estimated pose.
        """
        self._restart(reason)
        if self.spec.maps:
            sigmas = np.array((OWN_SIGMA_M, OWN_SIGMA_M, OWN_SIGMA_RAD))
            self.filter.place(self.pose, np.diag(sigmas * sigmas))
        else:
            self.filter.add(self._of_map)
            self.filter.doubt(self.spec.lost_sigma_m, math.pi / 2)
        self._of_map = NONE
        self._signals.forget()
        self.driven_m = self._matched_path_m = self._seen_path_m = 0.0
        self._since_tried = 0

    def join(self) -> None:
        """The frame in which the robot goes has been found to be, or has been moved to, the arena frame."""
        self.lost = ""
        self.watch.reset()

    def part(self, reason: str) -> None:
        """The robot's frame is no longer the arena frame; the estimate continues in it."""
        self.lost = reason
        self._signals.forget()
        self._since_tried = 0

    def _find_by_motes(self) -> None:
        found = (
            find_robot(self._signals.seen_from_here(), self.spec.path_loss)
            if self._signals.can_find(self.driven_m)
            else None
        )
        if found is None:
            return
        pose, covariance = found
        if max(covariance[0, 0], covariance[1, 1]) < FOUND_SIGMA_M**2 and covariance[2, 2] < FOUND_SIGMA_RAD**2:
            self.arena_fix = pose, covariance

    def place(self, pose: Pose2D, covariance: Floats) -> None:
        """The robot is here in the arena: m², m·rad, rad²."""
        self._restart("")
        self._of_map = NONE
        self.filter.place(pose, covariance)

    def _restart(self, lost: str) -> None:
        self.lost = lost
        self.beginnings += 1
        self.fits = True
        self.arena_fix = None
        self.watch.reset()

    def _search(
        self, log_odds: NDArray[np.int8], geometry: GridGeometry, guess: Pose2D, points: Floats
    ) -> Pose2D | None:
        """Pose where the scan fits about the guess, if it fits well and in one place only."""
        within_m = min(3.0 * self.filter.sigma_m, self.spec.search_within_m)
        within_rad = min(3.0 * self.filter.sigma_rad, SEARCH_WITHIN_RAD)
        return search_scan(log_odds, geometry, guess, points, within_m=within_m, within_rad=within_rad)
