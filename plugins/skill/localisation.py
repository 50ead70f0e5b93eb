"""Localisation: dead reckoning from a known start, corrected by motes of known place and by the walls of the map.

The odometry's pose stays continuous in the frame odom. Corrections move that frame in the arena, T_arena_odom (REP
105).
"""

import logging
import math
from collections import deque
from typing import Protocol

import msgspec
import numpy as np

from robrain.agent.event import Event
from robrain.agent.plugin import Skill, external
from robrain.algorithms.localization.localiser import DivergenceSpec, Localiser, LocaliserSpec
from robrain.algorithms.localization.odometry import chord
from robrain.algorithms.localization.pose_filter import DriftModel
from robrain.algorithms.localization.rssi_ranging import PathLoss
from robrain.algorithms.localization.surface_match import COMPARED_MIN, agreement
from robrain.algorithms.mapping.local_map import ArenaFix, LocalPose, OwnMap
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.slam.robots_in_scan import robot_circles, wall_ends
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.plugins.unit.driver.interface import DriverInterface, OdometryNoise
from robrain.protocol.clock import to_ns
from robrain.protocol.model.accuracy import recent_agreement
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D, Twist2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.ranges import STAMP_MAX, Positive, Share

logger = logging.getLogger(__name__)


class Divergence(msgspec.Struct, frozen=True, kw_only=True):
    """The robot is lost, or is localised again."""

    is_lost: bool
    why: str
    pose: Pose2D
    """Present estimate of T_arena_robot."""
    sigma_m: float
    """Standard deviation of that place."""


class LocalisationHealth(msgspec.Struct, frozen=True, kw_only=True):
    """Quality of the estimate, and the sources that it rests on."""

    lost: str
    """Reason why the estimate is invalid; empty while it is valid."""
    sigma_m: float
    sigma_rad: float
    mean_nis: float
    """Mean normalised innovation squared of the last signals of motes; about 1 or below when all is well."""
    signals: int
    """Signals of motes that were used."""
    signals_refused: int
    """Signals that contradicted the estimated place."""
    matches: int
    """Scans that matched walls of the map."""
    last_fit: float
    """Share of the last such scan's beams that ended at the map's walls."""
    scale_error: float
    """Estimated errors of the odometry: of the path, …"""
    curve_rad_per_m: float
    """… undetected turning for each metre ahead, …"""
    turn_error: float
    """… and of the turning."""


class LocalisationInterface(Protocol):
    """The robot's place in the team's frame."""

    diverged: Event[Divergence]
    """Sent when the robot is lost, and again when it is localised."""

    def pose(self) -> Pose2D:
        """T_arena_robot now."""

    def to_odom(self, points: list[Point2D]) -> list[Point2D]:
        """Points of the arena frame in the frame odom."""

    def health(self) -> LocalisationHealth:
        """Quality of the estimate."""


STILL = Twist2D()

AGREE_PERIOD_S = 1.0
"""Seconds between two comparisons of a scan with the team's map."""
WAITING_MAX = 16
"""Number of scans that wait for the odometry of their time."""
PAUSE_M, PAUSE_RAD = 0.1, 0.05
"""Largest push of a robot while its localisation paused; chosen."""


WALK_SHARE, CURVE_WALK_SHARE = 1 / 60, 1 / 100
"""Random walk of the odometry's errors per √m, as shares of the errors: floors and loads change; chosen."""


class OdometryErrors(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Errors of the odometry that stay: standard deviations before anything is known. All chosen.

    A calibrated base states smaller ones. They decide for how far a robot trusts its odometry alone.
    """

    scale: float = 0.03
    curve_rad_per_m: float = 0.03
    turn: float = 0.03

    @property
    def share(self) -> float:
        """Ratio of the errors to those of an unmeasured base, at most 1."""
        return min(max(self.scale, self.curve_rad_per_m) / 0.03, 1.0)


NO_TEAMMATES: Floats = np.empty((0, 3))


class Localisation(Skill):
    """Estimates the robot's pose in the arena with its uncertainty, and detects that it is lost."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """The robot's start, arena frame, and the sources of corrections.

        Values that are no place are chosen.
        """

        x_m: float = 0.0
        y_m: float = 0.0
        yaw_rad: float = 0.0
        start_known: bool = True
        """Whether the start is known; if not, the robot is lost until motes or the team's map have found it."""
        start_sigma_m: Positive = 0.02
        start_sigma_rad: Positive = 0.01
        motes: bool = True
        """Whether to use signals of motes at known places; needs the plugin mote_ranges."""
        scan_matching: bool = True
        """Whether to match scans with the map; needs the plugin mapper."""
        scan_period_s: Positive = 0.2
        """Seconds between two matches of a standing robot."""
        scan_path_m: Positive = 0.03
        """Metres of path between two matches of a moving robot; turns count as in
        `algorithms/localization/localiser.py`."""
        wall_slack_cells: Share = 0.0
        """Offsets of a scan below this many cells of the map count as zero. Raise it for a base whose odometry is
        better than the map's cells, such as an exact one."""
        errors: OdometryErrors = OdometryErrors()
        path_loss: PathLoss = PathLoss()
        watch: DivergenceSpec = DivergenceSpec()

        def spec(self, noise: OdometryNoise) -> LocaliserSpec:
            """For a base with such an odometry.

            Where small offsets of scans count as zero, nothing but the odometry's errors decides for the doubt.
            """
            errors = self.errors
            drift = DriftModel(
                sigma_m_per_sqrt_m=noise.sigma_m_per_sqrt_m,
                sigma_rad_per_sqrt_m=noise.sigma_rad_per_sqrt_m,
                sigma_rad_per_sqrt_rad=noise.sigma_rad_per_sqrt_rad,
                scale=errors.scale,
                curve_rad_per_m=errors.curve_rad_per_m,
                turn=errors.turn,
                scale_per_sqrt_m=errors.scale * WALK_SHARE,
                curve_rad_per_m_per_sqrt_m=errors.curve_rad_per_m * CURVE_WALK_SHARE,
                turn_per_sqrt_m=errors.turn * WALK_SHARE,
            )
            return LocaliserSpec(
                drift=drift,
                least_share=errors.share if self.wall_slack_cells else 1.0,
                path_loss=self.path_loss,
                watch=self.watch,
                slack_cells=self.wall_slack_cells,
                maps=self.scan_matching,
            )

    interface = LocalisationInterface
    period_s = 0.1
    parameters: Parameters
    diverged = Event[Divergence](outside=True)

    def activate(self) -> None:
        self._own_map = self.env.board.shared(OwnMap)
        self._driver = self.env.use("driver", DriverInterface)
        start = self.parameters
        self._odometry = self._driver.pose()
        self._T_arena_odom, sigma_m, sigma_rad = self._where_it_was()
        self._localiser = Localiser(
            self._T_arena_odom.compose(self._odometry), sigma_m, sigma_rad, start.spec(self._driver.odometry_noise())
        )
        board = self.env.board
        if board.frame != ARENA:
            self._localiser.part(board.lost)
        elif not start.start_known and board.T_arena_odom is None:
            self._localiser.lose("nobody has said where it starts")
        self._own_map.may_be_at = self._localiser.may_be_at
        self._lost = board.lost
        self._T_arena_local = IDENTITY if self._own_map.local_map is None else self._own_map.local_map.T_arena_local
        self._trajectories_before = 0 if self._own_map.local_pose is None else self._own_map.local_pose.trajectory
        self._centred = self._trajectories_before
        """The last trajectory that needs no move to the middle of the map."""
        self._waiting: deque[LaserScan] = deque(maxlen=WAITING_MAX)
        self._checked: deque[int] = deque(maxlen=WAITING_MAX)
        """Stamps of the last scans that were matched."""
        self._signals = self._matches = 0
        self._last_fit = 0.0
        self._scan_due_ns = 0
        self._matched_path_m = 0.0
        self._agree_due_ns = 0
        self._until_ns = 0 if start.scan_matching else STAMP_MAX
        self._checked_version = 0
        self._is_corrected = False
        if start.scan_matching:
            self.env.observe(self.env.use("scan", ScanInterface).scanned, self._see)
        self.env.board.radius_m = self._driver.radius_m()
        self._publish()

    def step(self) -> None:
        self._update_from_map()
        self._move()
        self._receive()
        self._match()
        self._publish()
        self.env.board.pose = self._T_arena_odom.compose(self._odometry)
        self.env.board.velocity = self._driver.velocity()

    @external
    def pose(self) -> Pose2D:
        """T_arena_robot now."""
        return self._T_arena_odom.compose(self._driver.pose())

    @property
    def _trajectory(self) -> int:
        return self._trajectories_before + self._localiser.beginnings

    def to_odom(self, points: list[Point2D]) -> list[Point2D]:
        """Points of the arena frame in the frame odom."""
        T_odom_arena = self._T_arena_odom.inverse()
        cos, sin = math.cos(T_odom_arena.yaw_rad), math.sin(T_odom_arena.yaw_rad)
        return [
            Point2D(
                T_odom_arena.x_m + cos * point.x_m - sin * point.y_m,
                T_odom_arena.y_m + sin * point.x_m + cos * point.y_m,
            )
            for point in points
        ]

    @external
    def health(self) -> LocalisationHealth:
        """Quality of the estimate, and the sources that it rests on."""
        localiser = self._localiser
        scale, curve, turn = localiser.filter.biases
        return LocalisationHealth(
            lost=localiser.lost,
            sigma_m=localiser.sigma_m,
            sigma_rad=float(np.sqrt(localiser.covariance[2, 2])),
            mean_nis=localiser.watch.mean_nis,
            signals=self._signals,
            signals_refused=localiser.watch.refused,
            matches=self._matches,
            last_fit=self._last_fit,
            scale_error=scale,
            curve_rad_per_m=curve,
            turn_error=turn,
        )

    def _where_it_was(self) -> tuple[Pose2D, float, float]:
        """T_arena_odom with the sigmas of place and yaw: the start, or, after a pause, the widened estimate."""
        start, board = self.parameters, self.env.board
        if board.T_arena_odom is None or len(board.pose_covariance) != 9:
            return Pose2D(start.x_m, start.y_m, start.yaw_rad), start.start_sigma_m, start.start_sigma_rad
        var_x, var_y, var_yaw = board.pose_covariance[0], board.pose_covariance[4], board.pose_covariance[8]
        return board.T_arena_odom, math.sqrt(max(var_x, var_y)) + PAUSE_M, math.sqrt(var_yaw) + PAUSE_RAD

    def _move(self) -> None:
        before, self._odometry = self._odometry, self._driver.pose()
        displacement = chord(before, self._odometry)
        if displacement != STILL:
            self._localiser.move(displacement)

    def _receive(self) -> None:
        received = self.env.board.mote_ranges
        while received:
            sample = received.popleft()
            if self.parameters.motes:
                self._localiser.receive(sample)
                self._signals += 1

    def _update_from_map(self) -> None:
        """Move the estimate with the robot's own map, which loop closures may have moved."""
        if self._own_map.misplaced:
            self._localiser.lose(self._own_map.misplaced)
            self._own_map.misplaced = ""
        local = self._own_map.local_map
        if local is None or local.trajectory != self._trajectory:
            return
        if local.T_arena_local != self._T_arena_local:
            self._localiser.shift(local.T_arena_local.compose(self._T_arena_local.inverse()))
            self._is_corrected = True
            self._T_arena_local = local.T_arena_local
        if local.frame == ARENA and self._localiser.lost:
            self._localiser.join()
        elif local.frame != ARENA and not self._localiser.lost:
            self._localiser.part(local.reason)

    def _see(self, scan: LaserScan) -> None:
        self._waiting.append(scan)
        self._match()

    def _match(self) -> None:
        """Match the waiting scans whose time the odometry covers."""
        if not self._waiting:
            return
        until_ns = self._driver.odometry_until_ns()
        while self._waiting and self._waiting[0].stamp_ns <= until_ns:
            self._handle_scan(self._waiting.popleft())

    def _handle_scan(self, scan: LaserScan) -> None:
        self._check_start(scan)
        board, now_ns = self.env.board, self.env.clock.now_ns()
        self._until_ns = scan.stamp_ns
        self._update_from_map()
        self._move()
        path_m = self._localiser.driven_m - self._matched_path_m
        is_due = now_ns >= self._scan_due_ns or path_m > self.parameters.scan_path_m
        if board.map is None or not is_due:
            self._publish()
            return
        self._checked.append(scan.stamp_ns)
        self._scan_due_ns = now_ns + to_ns(self.parameters.scan_period_s)
        self._matched_path_m = self._localiser.driven_m
        T_robot_sensor = self._T_robot_sensor(scan)
        points = self._wall_points(scan, T_robot_sensor)
        if self._own_map.local_map is not None and self._own_map.local_map.trajectory == self._trajectory:
            fit = self._localiser.see(points, self._own_map.local_map, T_robot_sensor)
            if fit.directions:
                self._matches += 1
                self._last_fit = fit.fit
            self._agree(points, board.map, T_robot_sensor)
        self._publish()

    def _agree(self, points: Floats, team: OccupancyGrid, T_robot_sensor: Pose2D) -> None:
        """Compare the scan with the team's map once every `AGREE_PERIOD_S`."""
        now_ns = self.env.clock.now_ns()
        if now_ns < self._agree_due_ns:
            return
        self._agree_due_ns = now_ns + to_ns(AGREE_PERIOD_S)
        sensor = self._localiser.pose.compose(T_robot_sensor)
        share, compared = agreement(team.log_odds, team.geometry, sensor, points)
        if compared >= COMPARED_MIN * len(points) > 0:
            self.env.board.map_agreement = recent_agreement(self.env.board.map_agreement, share)

    def _wall_points(self, scan: LaserScan, T_robot_sensor: Pose2D) -> Floats:
        """(K, 2) ends of the beams, sensor's frame, without those that ended at a teammate."""
        sensor = self._localiser.pose.compose(T_robot_sensor)
        reported = self._own_map.robot_places
        teammates = NO_TEAMMATES if reported is None else reported
        circles = robot_circles(scan.angles_rad, scan.ranges_m, scan.range_max_m, sensor, teammates)
        return wall_ends(scan.angles_rad, scan.ranges_m, scan.range_max_m, sensor, circles)

    def _T_robot_sensor(self, scan: LaserScan) -> Pose2D:
        """Pose of the sensor at the time of the scan, relative to the robot's current pose."""
        return self._odometry.inverse().compose(self._driver.pose_at(scan.stamp_ns))

    def _check_start(self, scan: LaserScan) -> None:
        """Check whether the robot is at its configured start.

        The map that the others made before it came may show it.
        """
        others = self._own_map.map_of_others
        if others is None or others.version == self._checked_version:
            return
        self._checked_version = others.version
        self._move()
        T_robot_sensor = self._T_robot_sensor(scan)
        self._localiser.check_start(
            others.log_odds, others.geometry, self._wall_points(scan, T_robot_sensor), T_robot_sensor
        )
        if self._localiser.lost:
            self._own_map.false_start = True
            self._publish()

    def _handle_fix(self) -> None:
        """Motes have localised the robot in the arena: place the frame of its map by this."""
        localiser = self._localiser
        fix, localiser.arena_fix = localiser.arena_fix, None
        if fix is None:
            return
        pose, covariance = fix
        if self._own_map.local_map is None or self._own_map.local_map.trajectory != self._trajectory:
            localiser.place(pose, covariance)
        else:
            T_arena_frame = pose.compose(localiser.pose.inverse())
            self._own_map.arena_fix = ArenaFix(T_arena_frame, pose, covariance, self._trajectory)

    def _centre(self) -> None:
        """Begin a frame of the robot's own in the middle of the map: nearer to an edge, less floor fits on it."""
        team, trajectory = self.env.board.map, self._trajectory
        if trajectory == self._centred or team is None or not self.parameters.scan_matching:
            return
        self._centred = trajectory
        if not self._localiser.lost:
            return
        pose = self._localiser.pose
        middle = team.geometry.center_of(team.geometry.height // 2, team.geometry.width // 2)
        self._localiser.shift(Pose2D(middle.x_m, middle.y_m, pose.yaw_rad).compose(pose.inverse()))
        self._T_arena_local = IDENTITY
        self._is_corrected = True

    def _publish(self) -> None:
        self._handle_fix()
        self._centre()
        localiser, board = self._localiser, self.env.board
        reported, maps = localiser.estimate(), self.parameters.scan_matching
        # Without a correction, the frame stays unchanged, to the last bit.
        if self._signals or self._matches or self._is_corrected:
            self._T_arena_odom = reported.pose.compose(self._odometry.inverse())
        board.T_arena_odom = self._T_arena_odom
        T_local_odom = self._T_arena_odom
        if self._T_arena_local != IDENTITY:
            T_local_odom = self._T_arena_local.inverse().compose(T_local_odom)
        self._own_map.local_pose = LocalPose(
            T_local_odom,
            self._trajectory,
            reported.drift,
            self._until_ns,
            localiser.fits,
            reported.local_sigma_m,
            localiser.lost if maps else "",
            tuple(self._checked) if maps else None,
        )
        board.pose_covariance = reported.covariances
        board.lost = localiser.lost
        if localiser.lost != self._lost:
            is_lost, self._lost = bool(localiser.lost), localiser.lost
            reason = localiser.lost or "found again"
            logger.warning("%s: localisation %s", self.env.robot, f"has diverged: {reason}" if is_lost else reason)
            self.diverged.notify(
                Divergence(is_lost=is_lost, why=reason, pose=localiser.pose, sigma_m=localiser.sigma_m)
            )
