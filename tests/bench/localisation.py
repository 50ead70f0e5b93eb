"""Localisation: how wrong the robot's place is, beside odometry alone and the best that any estimator could do.

The world is that of `localisation_world`; each figure is over the same `SEEDS` runs of 5 minutes. All rows but those
of other linearisations use the localiser as the plugin does, with its defaults: they are the same in worlds with and
without static shadowing. A run is *silently* diverged if the true place lies outside the 99.999 % ellipse for 10 s on
end and nothing is said.

Figures of the localiser were chosen on `SEEDS` and on 1000 to 1049; `FRESH` seeds were looked at only afterwards.
"""

import math
import statistics
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.localization.localiser import Localiser, LocaliserSpec
from robrain.algorithms.localization.pose_filter import DriftModel, PoseFilter
from robrain.algorithms.localization.pose_mixture import PoseMixture
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.localization.scan_match import beam_ends
from robrain.algorithms.mapping.local_map import NO_DRIFT, NONE, LocalMap
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.mapping.ray_cast import cast_rays
from robrain.algorithms.slam.map_overlap import MapMatcher
from robrain.lab.bench.figure import Figure, at_most, deterministic
from robrain.protocol.model.geometry import IDENTITY, Pose2D, Twist2D
from robrain.protocol.model.grid_geometry import GridGeometry
from tests.bench.localisation_world import (
    BLOCK_M,
    DRIFT,
    SIDE_M,
    SIGMA_DB,
    START_SIGMA_M,
    START_SIGMA_RAD,
    STEP_S,
    Drive,
    correlated,
    drive,
    kidnapped,
)
from tests.bench.position_bound import position_bound_m
from tests.bench.side_by_side import side_by_side

SEEDS = range(50)
FRESH = range(2000, 2050)
BOUND_SEEDS = 20
"""The bound is dear in plain numpy and hardly differs from run to run; of all 50 it is within 0.01 m of this."""
SPEC = LocaliserSpec()
STATIC = 0.7
OUTSIDE = 23.0
"""99.999 % of a chi-square variable of two degrees of freedom."""
SILENT_S = 10.0
KIDNAPPED_S, KIDNAPPED_M = 150.0, 6.0
FOUND_M = 1.5
RAYS, RANGE_M, RANGE_NOISE_M, SCAN_STEPS = 180, 6.0, 0.01, 5
SEARCH_STEPS = 2 * SCAN_STEPS
"""A lost robot looks for itself once a second."""


class Track(NamedTuple):
    """What became of one run."""

    rmse_m: float
    diverged: int
    """How often the localiser said that it was lost."""
    silent_s: float
    """The longest time that the truth lay outside the ellipse and nothing was said."""
    nees: float
    """Mean normalised estimation error squared of x and y; 2 if the covariance is right."""
    told_s: float
    """From the kidnapping until it was said; inf if it never was."""
    found_s: float
    """From the kidnapping until the error was below `FOUND_M` and nothing wrong, for good."""


def measure() -> list[Figure]:
    """All figures of the localisation."""
    runs = _runs(SEEDS)
    white, with_motes, scans, both = runs.white, runs.with_motes, runs.scans, runs.both
    alone = side_by_side(partial(follow, motes=False), white)
    bound_m = statistics.median(side_by_side(partial(_bound_m, 0.0), white[:BOUND_SEEDS]))
    static_bound_m = statistics.median(side_by_side(partial(_bound_m, STATIC), runs.static[:BOUND_SEEDS]))
    taken = side_by_side(follow, [kidnapped(each, KIDNAPPED_S, KIDNAPPED_M) for each in white])
    return [
        _row("odometry alone", alone),
        deterministic("posterior Cramér–Rao bound of motes", bound_m, "m", beside=f"of {BOUND_SEEDS} runs"),
        _row("motes", with_motes, 0.6),
        _row("motes, 70 % of the variance static", runs.with_static, 1.4, f"Cramér–Rao bound {static_bound_m:.2f} m"),
        _row("motes, 70 % static for some 3 m", runs.field, 1.4),
        _row("walls within 6 m, no motes", scans),
        _share("walls within 6 m, no motes: over odometry alone", scans, alone),
        _row("walls and motes", both),
        _share("walls and motes: over motes alone", both, with_motes),
        *_without_watch(white),
        _silence("motes", [*with_motes, *runs.with_static, *runs.field]),
        _silence("walls", scans),
        _silence("walls and motes", both),
        *_fresh(),
        *_kidnapping(taken),
    ]


def _fresh() -> list[Figure]:
    """The main figures again, on seeds that nothing was chosen on."""
    runs = _runs(FRESH)
    seeds = f"seeds {FRESH.start} to {FRESH.stop - 1}"
    return [
        _row("fresh seeds: motes", runs.with_motes, 0.6, seeds),
        _row("fresh seeds: 70 % of the variance static", runs.with_static, 1.4, seeds),
        _row("fresh seeds: 70 % static for some 3 m", runs.field, 1.4, seeds),
        _row("fresh seeds: walls and motes", runs.both, beside=seeds),
        _share("fresh seeds: walls and motes over motes alone", runs.both, runs.with_motes),
        _silence("fresh seeds", [*runs.with_motes, *runs.with_static, *runs.field, *runs.scans, *runs.both]),
    ]


class _Runs(NamedTuple):
    """The same seeds in several worlds, followed with several sensors."""

    white: list[Drive]
    static: list[Drive]
    with_motes: list[Track]
    with_static: list[Track]
    field: list[Track]
    scans: list[Track]
    both: list[Track]


def _runs(seeds: range) -> _Runs:
    white, static = (side_by_side(partial(drive, static_share=share), seeds) for share in (0.0, STATIC))
    field = [correlated(each, seed) for seed, each in zip(seeds, white, strict=True)]
    followed = [side_by_side(follow, worlds) for worlds in (white, static, field)]
    scans = side_by_side(partial(follow, motes=False, scans=True), white)
    return _Runs(white, static, *followed, scans, side_by_side(partial(follow, scans=True), white))


def _bound_m(static_share: float, world: Drive) -> float:
    return position_bound_m(world, DRIFT, static_share)


def follow(world: Drive, *, motes: bool = True, scans: bool = False, spec: LocaliserSpec = SPEC) -> Track:
    """One run of the localiser."""
    localiser = Localiser(world.start, START_SIGMA_M, START_SIGMA_RAD, spec)
    eyes = _Eyes(world) if scans else None
    watched = _Watched()
    for step, displacement in enumerate(world.measured.tolist()):
        localiser.move(Twist2D(*displacement))
        if motes:
            for mote, rssi_dbm in world.heard[step]:
                localiser.receive(RssiSample(f"m{mote}", world.motes[mote], rssi_dbm))
            if localiser.arena_fix is not None:
                localiser.place(*localiser.arena_fix)
        if eyes is not None and step % SCAN_STEPS == 0:
            eyes.look(localiser, Pose2D(*world.true[step + 1].tolist()), step)
        watched.note(step, world.true[step + 1], localiser)
    return watched.track()


class _Watched:
    """Compares with the truth."""

    def __init__(self) -> None:
        self._squares: list[float] = []
        self._nees: list[float] = []
        self._outside = self._longest = 0
        self._diverged = 0
        self._was_lost = False
        self._reported_s = self._wrong_s = math.inf

    def note(self, step: int, true: NDArray[np.float64], localiser: Localiser) -> None:
        pose, covariance = localiser.pose, localiser.covariance
        dx, dy = true[0] - pose.x_m, true[1] - pose.y_m
        p_xx, p_xy, p_yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
        nees = (p_yy * dx * dx - 2 * p_xy * dx * dy + p_xx * dy * dy) / (p_xx * p_yy - p_xy * p_xy)
        self._squares.append(dx * dx + dy * dy)
        self._nees.append(nees)
        is_lost = bool(localiser.lost)
        self._outside = self._outside + 1 if nees > OUTSIDE and not is_lost else 0
        self._longest = max(self._longest, self._outside)
        self._diverged += is_lost and not self._was_lost
        self._was_lost = is_lost
        since_s = (step + 1) * STEP_S - KIDNAPPED_S
        if since_s > 0:
            if is_lost:
                self._reported_s = min(self._reported_s, since_s)
            if is_lost or dx * dx + dy * dy > FOUND_M**2:
                self._wrong_s = since_s

    def track(self) -> Track:
        return Track(
            math.sqrt(statistics.fmean(self._squares)),
            self._diverged,
            self._longest * STEP_S,
            statistics.fmean(self._nees),
            self._reported_s,
            self._wrong_s,
        )


class _Eyes:
    """A lidar, and the map that is made of its scans while the robot goes."""

    def __init__(self, world: Drive) -> None:
        cells = round(SIDE_M / 0.1) + 2
        self._geometry = GridGeometry(0.1, -0.1, -0.1, cells, cells)
        self._walls = np.ones(self._geometry.shape, np.bool_)
        self._walls[1:-1, 1:-1] = False
        for x_m, y_m in world.blocks.tolist():
            row, column = self._geometry.cell_of(x_m - BLOCK_M / 2, y_m - BLOCK_M / 2)
            self._walls[row : row + round(BLOCK_M / 0.1), column : column + round(BLOCK_M / 0.1)] = True
        self._team = OccupancyGrid(self._geometry)
        """All that was ever seen: where a lost robot is looked for."""
        self._own = OccupancyGrid(self._geometry, surfaces=True)
        self._trajectory = -1
        self._begun = IDENTITY, NONE, NO_DRIFT, (0.0, 0.0)
        self._angles_rad = np.linspace(-math.pi, math.pi, RAYS, endpoint=False)
        self._rng = np.random.default_rng(5)
        self._nobody = np.empty((0, 3))

    def look(self, localiser: Localiser, true: Pose2D, step: int) -> None:
        ranges_m = cast_rays(self._walls, self._geometry, true, self._angles_rad, RANGE_M, self._nobody)
        ranges_m[ranges_m < RANGE_M] += RANGE_NOISE_M * self._rng.standard_normal(int((ranges_m < RANGE_M).sum()))
        points = beam_ends(self._angles_rad, ranges_m, RANGE_M)
        self._restart(localiser)
        anchor, variances, drift, with_yaw = self._begun
        own = LocalMap(self._own, IDENTITY, anchor, variances, drift, 1, 1, self._trajectory, with_yaw=with_yaw)
        localiser.see(points, own)
        if localiser.lost and step % SEARCH_STEPS == 0:
            self._find(localiser)
        self._restart(localiser)
        if not localiser.fits:
            return
        for grid in (self._own,) if localiser.lost else (self._team, self._own):
            grid.integrate_scan(
                localiser.pose, self._angles_rad, ranges_m, RANGE_M, step, self._nobody, localiser.drift
            )

    def _restart(self, localiser: Localiser) -> None:
        """As the mapper: a robot that was lost or found begins its own map anew."""
        if localiser.beginnings != self._trajectory:
            self._trajectory = localiser.beginnings
            self._own.forget()
            xx, _, xt, _, yy, yt, _, _, tt = localiser.covariances
            self._begun = localiser.pose, (xx, yy, tt), localiser.drift, (xt, yt)

    def _find(self, localiser: Localiser) -> None:
        """As the mapper, but with one answer: what the robot has seen since it was lost is laid on the team's map."""
        found = MapMatcher(self._own, self._team).find(localiser.pose)
        if found is None:
            return
        pose = found.T_other_own.compose(localiser.pose)
        if localiser.may_be_at(pose):
            localiser.place(pose, np.diag((0.01, 0.01, 0.0004)))


def _without_watch(worlds: list[Drive]) -> list[Figure]:
    """The filter alone, with and without its states for the odometry's errors."""
    none = DriftModel(scale=0.0, curve_rad_per_m=0.0, turn=0.0)
    cases = (("Gauss–Hermite points (as used)", DRIFT), ("no states for the odometry's errors", none))
    return [
        _row(f"motes, the filter alone, {name}", side_by_side(partial(_filter_only, drift=drift), worlds))
        for name, drift in cases
    ]


def _filter_only(world: Drive, drift: DriftModel) -> Track:
    """The filter without watch; told the radio's true parameters."""
    spec = LocaliserSpec(drift=drift, path_loss=PathLoss(shadowing_db=0.0, fading_db=SIGMA_DB))
    localiser = Localiser(world.start, START_SIGMA_M, START_SIGMA_RAD, spec)
    estimate = PoseFilter(world.start, START_SIGMA_M, START_SIGMA_RAD, drift, spec.path_loss)
    localiser.filter = PoseMixture(estimate, parts_max=1)
    watched = _Watched()
    for step, displacement in enumerate(world.measured.tolist()):
        estimate.move(Twist2D(*displacement))
        for mote, rssi_dbm in world.heard[step]:
            estimate.receive(RssiSample(f"m{mote}", world.motes[mote], rssi_dbm))
        watched.note(step, world.true[step + 1], localiser)
    return watched.track()


def _silence(what: str, tracks: list[Track]) -> Figure:
    silent = sum(track.silent_s >= SILENT_S for track in tracks)
    longest_s = max(track.silent_s for track in tracks)
    said = sum(track.diverged for track in tracks)
    beside = f"{SILENT_S:g} s on end, longest {longest_s:.1f} s; {said} times said to be lost; {len(tracks)} runs"
    return deterministic(f"{what}: runs that diverged and did not say so", silent, "", at_most(0), beside)


def _kidnapping(tracks: list[Track]) -> list[Figure]:
    told, found = [track.told_s for track in tracks], [track.found_s for track in tracks]
    left_s = 300.0 - KIDNAPPED_S
    count = sum(found_s < left_s - STEP_S for found_s in found)
    case = f"carried off by {KIDNAPPED_M:g} m"
    after = f"p90 {np.percentile(told, 90):.0f} s; {count} of {len(tracks)} found again"
    return [
        deterministic(f"{case}: runs in which it was never said", sum(map(math.isinf, told)), "", at_most(0)),
        deterministic(f"{case}: said after, median", statistics.median(told), "s", beside=after),
        deterministic(f"{case}: found again after, median", statistics.median(found), "s"),
    ]


def _row(what: str, tracks: list[Track], bound_m: float | None = None, beside: str = "") -> Figure:
    spread = f"p90 {np.percentile([track.rmse_m for track in tracks], 90):.2f} m; NEES {_nees(tracks)}"
    bound = at_most(bound_m) if bound_m is not None else None
    beside = f"{spread}; {beside}" if beside else spread
    return deterministic(f"{what}: RMSE, median", _median(tracks), "m", bound, beside)


def _share(what: str, tracks: list[Track], base: list[Track]) -> Figure:
    return deterministic(f"{what}, medians", 100 * _median(tracks) / _median(base), "%", at_most(100))


def _median(tracks: list[Track]) -> float:
    return statistics.median(track.rmse_m for track in tracks)


def _nees(tracks: list[Track]) -> str:
    return f"{statistics.fmean(track.nees for track in tracks):.1f}"
