"""Plays a log to a robot's localisation and mapper, in lockstep: all but odometry and scans is as robots run it.

The host is that of every robot, with the stock plugins `localisation`, `mapper` and `teammates`; `driver` and `scan`
are those of this folder. Afterwards each scan lies where its submap has come to lie, loop closures included.
"""

from collections import deque
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import msgspec

from robrain.agent.board import Board
from robrain.agent.event import Event
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.agent.plugin import Device, Unit
from robrain.algorithms.localization.pose_track import PoseTrack
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.warm_up import warm_up
from robrain.deploy.errors import LogError
from robrain.lab.log_bench.carmen_log import CarmenLog, LogEntry, LoggedScan
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.plugins.device.scan.scan import ScanDevice
from robrain.plugins.skill.mapper.interface import MapperCounters
from robrain.plugins.unit.driver.driver import Driver
from robrain.plugins.unit.driver.interface import DriverInterface, OdometryNoise
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.wire.clock import VirtualClock, to_ns
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.keys import DEFAULT_TEAM
from robrain.protocol.wire.session import open_lockstep_session
from robrain.protocol.wire.topics import ROBOT_CALL, ROBOT_MAP_WHOLE


class LogScan(Device):
    """Stands in for the stock lidar; beams of which nothing is known have the range 0."""

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

    def doubt(self, why: str) -> None:
        """What is in the log is what the lidar said."""


HISTORY_ENTRIES = 1024
RADIUS_M = 0.2


class LogDriver(Unit):
    """Stands in for the stock driver, as far as localisation and mapper use it."""

    Parameters = Driver.Parameters
    interface = DriverInterface
    parameters: Driver.Parameters

    def init(self) -> None:
        self._track = PoseTrack(Pose2D(0.0, 0.0, 0.0), HISTORY_ENTRIES)

    def feed(self, stamp_ns: int, T_odom_robot: Pose2D) -> None:
        """Where the odometry had the robot; stamps do not descend."""
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


ROBOT = "r1"
LOAD = ["driver", "scan", "localisation", "mapper"]
OWN_PLUGINS = Path(__file__).parent
TICK_NS = 20_000_000
BEGIN_NS = 1_000_000_000
"""Of the run's clock, when the log begins."""
SETTLE_NS = 5_000_000_000
"""After the end of the log, so that the pose graph is solved once more."""
MARGIN_M = 10.0
"""The map reaches so far beyond what the lidar can have seen by odometry."""
RESOLUTION_M = 0.1
AREA_MAX_CELLS = 6000
"""Of either side of the map."""

Parameters = dict[str, dict[str, Any]]


class PlayedLog(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """What localisation and mapper made of a log; lists have an element for each scan."""

    stamps_s: list[float]
    """Of the log's clock."""
    odometry: list[Pose2D]
    """Where the odometry alone had the lidar; it begins at the origin."""
    told: list[Pose2D]
    """Where the robot said that it was, when it had laid the scan on its map."""
    poses: list[Pose2D]
    """The same after all loop closures."""
    lost: int
    """Scans during which the robot said that it is lost."""
    counters: MapperCounters
    map: OccupancyGrid


def play(log: CarmenLog, parameters: Parameters | None = None) -> PlayedLog:
    """Play a log to the plugins.

    Args:
        log: what is played.
        parameters: of the plugins, by name, as in a robot's file; the map's area is chosen by the log if they do not
            say it.

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
    told: Pose2D


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
            told=[each.told for each in self._placed],
            poses=[
                each.told if each.submap is None else lies[each.submap].compose(each.local) for each in self._placed
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
            self._look(self._host.board)

    def _look(self, board: Board) -> None:
        """Where the scans lie that were taken in by now."""
        local_pose, local_map, T_arena_odom = board.local_pose, board.local_map, board.T_arena_odom
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
    """The mapper's parameters, with an area that holds the log if they do not say one."""
    start = log.entries[0].odometry
    seen_m = max(float(entry.scan.ranges_m.max()) for entry in log.entries if entry.scan is not None)
    # The odometry may have turned in the meantime: nobody knows on which side of the start the robot has been.
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
