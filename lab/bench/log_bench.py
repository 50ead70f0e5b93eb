"""`robrain bench log`: accuracy of a robot's trajectory on a public lidar log, beside published results of others."""

import bisect
import math
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
from rich.table import Table

from robrain.agent.board import Board
from robrain.agent.event import Event
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.agent.plugin import Device, Unit
from robrain.algorithms.localization.odometry import PoseTrack
from robrain.algorithms.mapping.local_map import OwnMap
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.warm_up import warm_up
from robrain.deploy.command_line.terminal import new_console, print_line
from robrain.deploy.errors import LogError, UsageError
from robrain.lab.bench.carmen_log import (
    PLACE_MAX_M,
    STAMP_MAX_S,
    CarmenLog,
    LogEntry,
    LoggedScan,
    number_of,
    numbered_lines,
    read_carmen_log,
)
from robrain.lab.bench.figure import WIDTH, write_report
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.plugins.device.scan.scan import ScanDevice
from robrain.plugins.skill.mapper.mapper import MapperCounters
from robrain.plugins.unit.driver.driver import Driver
from robrain.plugins.unit.driver.interface import DriverInterface, OdometryNoise
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP_WHOLE
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session

SAME_S = 5e-4
"""A stamp of a relation is that of the scan that is so near."""
LOOP_S = 5.0
"""Relations over more time than this are also reported separately: the odometry has little influence on them."""
HISTORY_ENTRIES = 1024
RADIUS_M = 0.2
ROBOT = "r1"
LOAD = ["driver", "scan", "localisation", "mapper"]
TICK_NS = 20_000_000
BEGIN_NS = 1_000_000_000
"""Of the run's clock, when the log begins."""
SETTLE_NS = 5_000_000_000
"""After the end of the log, so that the pose graph is solved once more."""
MARGIN_M = 10.0
"""Margin of the map around the area that the lidar can have seen by odometry."""
RESOLUTION_M = 0.1
AREA_MAX_CELLS = 6000
"""Of either side of the map."""


class LogScan(Device):
    """Stands in for the stock lidar; beams without data have the range 0."""

    Parameters = ScanDevice.Parameters
    interface = ScanInterface
    period_s = 0.02
    scanned = Event[LaserScan]()

    def init(self) -> None:
        self._waiting: deque[LaserScan] = deque()
        self._latest: LaserScan | None = None

    def feed(self, scan: LaserScan) -> None:
        """Hand this on in the next step."""
        self._waiting.append(scan)

    def step(self) -> None:
        while self._waiting:
            self._latest = self._waiting.popleft()
            self.scanned.notify(self._latest)

    def latest(self) -> LaserScan | None:
        return self._latest

    def doubt(self, reason: str) -> None:
        """Do nothing: the log holds the lidar's output unchanged."""


class LogDriver(Unit):
    """Stands in for the stock driver, as far as localisation and mapper use it."""

    Parameters = Driver.Parameters
    interface = DriverInterface
    parameters: Driver.Parameters

    def init(self) -> None:
        self._track = PoseTrack(Pose2D(0.0, 0.0, 0.0), HISTORY_ENTRIES)

    def feed(self, stamp_ns: int, T_odom_robot: Pose2D) -> None:
        """Poses of the robot by odometry; stamps do not descend."""
        self._track.add(stamp_ns, T_odom_robot)

    def pose(self) -> Pose2D:
        return self._track.pose

    def pose_at(self, stamp_ns: int) -> Pose2D:
        return self._track.pose_at(stamp_ns)

    def odometry_until_ns(self) -> int:
        return self._track.until_ns or 0

    def velocity(self) -> Twist2D:
        return Twist2D()

    def odometry_noise(self) -> OdometryNoise:
        return self.parameters.odometry

    def radius_m(self) -> float:
        return RADIUS_M


OWN_PLUGINS = Path(__file__).parent

Parameters = dict[str, dict[str, Any]]


class PlayedLog(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """Results of localisation and mapper for a log; lists have an element for each scan."""

    stamps_s: list[float]
    """Of the log's clock."""
    odometry: list[Pose2D]
    """Poses of the lidar by odometry alone; they begin at the origin."""
    reported: list[Pose2D]
    """Pose that the robot reported after it had put the scan on its map."""
    poses: list[Pose2D]
    """The same after all loop closures."""
    lost: int
    """Scans during which the robot reported that it is lost."""
    counters: MapperCounters
    map: OccupancyGrid


def play(log: CarmenLog, parameters: Parameters | None = None) -> PlayedLog:
    """Play a log to the plugins.

    Args:
        log: the log.
        parameters: parameters of the plugins, by name, as in a robot's file; the log sets the map's area if they do
            not.

    Raises:
        LogError: the log covers too large an area.
        RobotFileError: there is no such plugin.

    """
    warm_up()
    chosen = {name: dict(table) for name, table in (parameters or {}).items()}
    chosen["mapper"] = _area(log, chosen.get("mapper", {}))
    with _host(chosen) as (host, clock, wire):
        run = _Run(log, host, clock)
        run.play()
        return run.result(wire)


class _Placed(msgspec.Struct, frozen=True):
    """A scan in the frame of the submap that was being made."""

    submap: int | None
    local: Pose2D
    reported: Pose2D


class _Run:
    def __init__(self, log: CarmenLog, host: AgentHost, clock: VirtualClock) -> None:
        self._log = log
        self._host = host
        self._clock = clock
        driver, scan = host.manager.get("driver").plugin, host.manager.get("scan").plugin
        assert isinstance(driver, LogDriver)
        assert isinstance(scan, LogScan)
        self._driver, self._scan = driver, scan
        self._T_start_odom = log.entries[0].odometry.inverse()
        self._waiting: deque[int] = deque()
        """Stamps of scans that localisation has not taken in yet."""
        self._placed: list[_Placed] = []
        self._lost = 0

    def play(self) -> None:
        first_s = self._log.entries[0].stamp_s
        for entry in self._log.entries:
            stamp_ns = BEGIN_NS + to_ns(entry.stamp_s - first_s)
            self._run_until(stamp_ns)
            self._feed(stamp_ns, entry)
        self._run_until(self._clock.now_ns() + SETTLE_NS)

    def result(self, wire: Endpoint) -> PlayedLog:
        entries = [entry for entry in self._log.entries if entry.scan is not None]
        lies = _submaps(wire)
        counters = wire.ask(ROBOT_CALL, b"[]", robot=ROBOT, plugin="mapper", function="counters")
        grid = self._host.board.map
        assert grid is not None
        return PlayedLog(
            stamps_s=[entry.stamp_s for entry in entries],
            odometry=[self._T_start_odom.compose(entry.odometry) for entry in entries],
            reported=[each.reported for each in self._placed],
            poses=[
                each.reported if each.submap is None else lies[each.submap].compose(each.local) for each in self._placed
            ],
            lost=self._lost,
            counters=msgspec.json.decode(counters, type=MapperCounters),
            map=grid,
        )

    def _feed(self, stamp_ns: int, entry: LogEntry) -> None:
        self._driver.feed(stamp_ns, self._T_start_odom.compose(entry.odometry))
        if entry.scan is not None:
            self._waiting.append(stamp_ns)
            self._scan.feed(_laser_scan(stamp_ns, entry.scan))

    def _run_until(self, stamp_ns: int) -> None:
        while (now_ns := self._clock.now_ns() + TICK_NS) <= stamp_ns:
            self._clock.advance_to(now_ns)
            self._host.step()
            self._check(self._host.board)

    def _check(self, board: Board) -> None:
        """Record the poses of the scans that were mapped by now."""
        own, T_arena_odom = board.shared(OwnMap), board.T_arena_odom
        local_pose, local_map = own.local_pose, own.local_map
        if local_pose is None or T_arena_odom is None:
            return
        while self._waiting and self._waiting[0] <= local_pose.until_ns:
            stamp_ns = self._waiting.popleft()
            odometry = self._driver.pose_at(stamp_ns)
            self._lost += bool(board.lost)
            self._placed.append(
                _Placed(
                    None if local_map is None else local_map.number,
                    local_pose.T_local_odom.compose(odometry),
                    T_arena_odom.compose(odometry),
                )
            )


@contextmanager
def _host(parameters: Parameters) -> Iterator[tuple[AgentHost, VirtualClock, Endpoint]]:
    clock = VirtualClock()
    table = RobotTable(ROBOT, places=[str(OWN_PLUGINS)], load=LOAD)
    with open_lockstep_session() as session:
        host = AgentHost(RobotFile(robot=table, parameters=parameters), Path(), session, clock, Drive.LOCKSTEP)
        with closing(host), closing(Endpoint(session, DEFAULT_TEAM, clock, Drive.LOCKSTEP)) as wire:
            host.start()
            yield host, clock, wire


def _submaps(wire: Endpoint) -> dict[int, Pose2D]:
    """`T_arena_local` of the robot's submaps, from its answer to `robot/R/map/whole`."""
    whole = wire.ask(ROBOT_MAP_WHOLE, robot=ROBOT)
    return {} if whole is None else {part.submap: part.T_arena_local for part in whole.parts if part.robot == ROBOT}


def _area(log: CarmenLog, mapper: dict[str, Any]) -> dict[str, Any]:
    """The mapper's parameters, with an area that holds the log if they have none."""
    start = log.entries[0].odometry
    seen_m = max(float(entry.scan.ranges_m.max()) for entry in log.entries if entry.scan is not None)
    # The odometry may have turned in the meantime: the robot's side of the start is unknown.
    away_m = max(entry.odometry.distance_m(start) for entry in log.entries)
    side_m = 2.0 * (away_m + seen_m + MARGIN_M)
    resolution_m = mapper.get("resolution_m", RESOLUTION_M)
    area = {"origin_x_m": -side_m / 2, "origin_y_m": -side_m / 2, "width_m": side_m, "height_m": side_m}
    merged = {"resolution_m": resolution_m, **area, **mapper}
    widest_m = max(merged["width_m"], merged["height_m"])
    if not widest_m <= AREA_MAX_CELLS * resolution_m:
        raise LogError(
            f"{log.name}: expected a log of at most {AREA_MAX_CELLS * resolution_m:g} m from one end to the other, "
            f"it covers {widest_m:.0f} m; a larger [parameters.mapper] resolution_m covers more"
        )
    return merged


def _laser_scan(stamp_ns: int, scan: LoggedScan) -> LaserScan:
    return LaserScan(stamp_ns, tuple(scan.angles_rad.tolist()), tuple(scan.ranges_m.tolist()), scan.range_max_m)


class Relation(msgspec.Struct, frozen=True):
    """Pose of the robot at `to_s`, relative to its pose at `from_s`; seconds of the log's clock."""

    from_s: float
    to_s: float
    pose: Pose2D


class RelativeErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Mean and standard deviation of absolute errors over relations."""

    relations: int
    mean_m: float
    sigma_m: float
    mean_deg: float
    sigma_deg: float


def read_relations(path: Path) -> list[Relation]:
    """Read a file of relations, lines of `t1 t2 x y z roll pitch yaw`.

    Raises:
        LogError: the file cannot be read, is too large, a line is wrong, or there is no relation in it.

    """
    relations = []
    for number, line in numbered_lines(path):
        words = line.split()
        try:
            if len(words) != 8:
                raise ValueError(f"expected t1 t2 x y z roll pitch yaw, got {len(words)} words")
            from_s, to_s = (number_of(word, 0.0, STAMP_MAX_S) for word in words[:2])
            x_m, y_m, _, _, _, yaw_rad = (number_of(word, -PLACE_MAX_M, PLACE_MAX_M) for word in words[2:])
        except ValueError as error:
            raise LogError(f"{path}: line {number}: {error}") from error
        relations.append(Relation(from_s, to_s, Pose2D(x_m, y_m, math.remainder(yaw_rad, math.tau))))
    if not relations:
        raise LogError(f"{path}: expected relations, lines of t1 t2 x y z roll pitch yaw; there are none")
    return relations


def relations_between(stamps_s: Sequence[float], relations: Sequence[Relation]) -> list[tuple[int, int, Relation]]:
    """Relations with the stamps of two scans, with the indices of the scans; stamps ascend."""
    found = []
    for relation in relations:
        first, second = _index(stamps_s, relation.from_s), _index(stamps_s, relation.to_s)
        if first is not None and second is not None:
            found.append((first, second, relation))
    return found


def relative_errors(
    poses: Sequence[Pose2D], relations: Sequence[tuple[int, int, Relation]], over_s: float = 0.0
) -> RelativeErrors | None:
    """Errors of a trajectory over relations of more than `over_s`; None if there is none of these.

    Args:
        poses: of the scans, in any one frame.
        relations: as `relations_between` gives them.
        over_s: relations over less time do not count.

    """
    errors_m, errors_deg = [], []
    for first, second, relation in relations:
        if abs(relation.to_s - relation.from_s) < over_s:
            continue
        found = poses[first].inverse().compose(poses[second])
        errors_m.append(found.distance_m(relation.pose))
        errors_deg.append(math.degrees(abs(math.remainder(found.yaw_rad - relation.pose.yaw_rad, math.tau))))
    if not errors_m:
        return None
    mean_m, sigma_m = _spread(errors_m)
    mean_deg, sigma_deg = _spread(errors_deg)
    return RelativeErrors(
        relations=len(errors_m), mean_m=mean_m, sigma_m=sigma_m, mean_deg=mean_deg, sigma_deg=sigma_deg
    )


def _index(stamps_s: Sequence[float], stamp_s: float) -> int | None:
    at = bisect.bisect_left(stamps_s, stamp_s)
    near = min((i for i in (at - 1, at) if 0 <= i < len(stamps_s)), key=lambda i: abs(stamps_s[i] - stamp_s))
    return near if abs(stamps_s[near] - stamp_s) <= SAME_S else None


def _spread(values: Sequence[float]) -> tuple[float, float]:
    mean = math.fsum(values) / len(values)
    return mean, math.sqrt(math.fsum((value - mean) ** 2 for value in values) / len(values))


class Published(msgspec.Struct, frozen=True):
    """Published results of others for the whole log and its whole file of relations."""

    log: str
    method: str
    errors: str


PUBLISHED = (
    Published("MIT CSAIL", "Cartographer (Hess et al. 2016)", "0.0319 ± 0.0363 m, 0.369 ± 0.365°"),
    Published("MIT CSAIL", "RBPF, GMapping (Kümmerle et al. 2009)", "0.049 ± 0.049 m"),
    Published("Intel Research Lab", "Cartographer (Hess et al. 2016)", "0.0229 ± 0.0239 m, 0.453 ± 1.335°"),
    Published("Intel Research Lab", "RBPF, GMapping (Kümmerle et al. 2009)", "0.070 ± 0.083 m"),
    Published("Freiburg 079", "Cartographer (Hess et al. 2016)", "0.0452 ± 0.0354 m, 0.538 ± 0.718°"),
    Published("Freiburg 079", "RBPF, GMapping (Kümmerle et al. 2009)", "0.061 ± 0.044 m"),
)


class Scored(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of one trajectory."""

    trajectory: str
    all: RelativeErrors
    loops: RelativeErrors | None
    """Over relations of more than `LOOP_S` alone."""


class LogReport(msgspec.Struct, frozen=True, kw_only=True):
    """Output of `--json`."""

    bench: str
    log: str
    scans: int
    duration_s: float
    path_length_m: float
    """By odometry."""
    lost: int
    """Scans during which the robot reported that it is lost."""
    left_out: int
    """Scans that were not mapped."""
    submaps: int
    closures: int
    contradictions: int
    relations: int
    relations_unused: int
    """Relations with a stamp that is no scan's."""
    errors: list[Scored]


def run_bench(
    log_file: Path,
    relations_file: Path | None = None,
    json_file: Path | None = None,
    map_file: Path | None = None,
    robot_file: Path | None = None,
) -> None:
    """Play a log, and print the results.

    Args:
        log_file: in the format of CARMEN.
        relations_file: known relations of pairs of its poses; without them errors are not reported.
        json_file: gets the figures as well.
        map_file: YAML file for the map, which does not exist yet; the picture has its name with `.pgm`.
        robot_file: ROBOT.toml whose parameters of `driver` (`odometry`), `localisation` and `mapper` are used.

    Raises:
        LogError: the log or the relations cannot be read.
        RobotFileError: `robot_file` cannot be read.
        UsageError: the relations do not fit the log, or the file of the map exists.

    """
    parameters = _parameters(robot_file)
    log = read_carmen_log(log_file)
    relations = read_relations(relations_file) if relations_file is not None else []
    matching = relations_between([entry.stamp_s for entry in log.entries if entry.scan is not None], relations)
    if relations and not matching:
        raise UsageError(f"--relations {relations_file}: no two stamps of a relation are those of scans in {log_file}")
    _check_free(map_file)
    print_line(f"{log.name}: {log.scans} scans in {log.duration_s:.0f} s")
    played = play(log, parameters)
    report = made_report(log, played, relations, matching)
    _show(report)
    if json_file is not None:
        write_report(json_file, report)
    if map_file is not None:
        _write_map(map_file, played)


def made_report(
    log: CarmenLog, played: PlayedLog, relations: list[Relation], matching: list[tuple[int, int, Relation]]
) -> LogReport:
    """The figures of a played log; `matching` are those of the relations between its scans."""
    trajectories = {
        "odometry alone": played.odometry,
        "as the robot reported it": played.reported,
        "after all loop closures": played.poses,
    }
    return LogReport(
        bench="log",
        log=log.name,
        scans=log.scans,
        duration_s=log.duration_s,
        path_length_m=_path_m(played.odometry),
        lost=played.lost,
        left_out=played.counters.scans_skipped,
        submaps=played.counters.submaps,
        closures=played.counters.closures,
        contradictions=played.counters.contradictions,
        relations=len(relations),
        relations_unused=len(relations) - len(matching),
        errors=[
            Scored(trajectory=name, all=errors, loops=relative_errors(poses, matching, LOOP_S))
            for name, poses in trajectories.items()
            if (errors := relative_errors(poses, matching)) is not None
        ],
    )


def _show(report: LogReport) -> None:
    print_line(
        f"path by odometry {report.path_length_m:.0f} m; lost during {report.lost} scans; "
        f"{report.left_out} scans not mapped; {report.submaps} submaps, "
        f"{report.closures} loop closures, {report.contradictions} contradictions"
    )
    if not report.errors:
        return
    used = report.relations - report.relations_unused
    title = f"errors over {used} of {report.relations} relations, mean ± standard deviation"
    headings = ("trajectory", "all relations", f"those over more than {LOOP_S:g} s")
    table = Table(*headings, title=title, title_justify="left")
    for each in report.errors:
        table.add_row(each.trajectory, _words(each.all), "–" if each.loops is None else _words(each.loops))
    console = new_console(width=WIDTH)
    console.print(table)
    title = "published for whole logs, all relations"
    beside = Table("log", "method", "errors", title=title, title_justify="left")
    for published in PUBLISHED:
        beside.add_row(published.log, published.method, published.errors)
    console.print(beside)


def _words(errors: RelativeErrors) -> str:
    return (
        f"{errors.mean_m:.4f} ± {errors.sigma_m:.4f} m, {errors.mean_deg:.3f} ± {errors.sigma_deg:.3f}° "
        f"({errors.relations})"
    )


def _path_m(poses: list[Pose2D]) -> float:
    return sum(before.distance_m(after) for before, after in pairwise(poses))


def _parameters(robot_file: Path | None) -> Parameters:
    if robot_file is None:
        return {}
    from robrain.agent.host.robot_file import read_robot_file

    found = read_robot_file(robot_file).parameters
    return {name: found[name] for name in ("driver", "localisation", "mapper") if name in found}


def _check_free(map_file: Path | None) -> None:
    """Before an hour of work, not after it."""
    if map_file is None:
        return
    for path in (map_file, map_file.with_suffix(".pgm")):
        if path.exists():
            raise UsageError(f"--map {path}: exists already; give another name or move it away")


def _write_map(path: Path, played: PlayedLog) -> None:
    from robrain.recording.export.map_server_files import write_grid

    for written in write_grid(played.map, path):
        print_line(f"wrote {written}")
