"""Mapper: an occupancy grid from the robot's own scans and from the patches of the others."""

import logging
import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.agent.event import Event
from robrain.agent.plugin import Skill, external
from robrain.algorithms.mapping.local_map import LocalPose, OwnMap
from robrain.algorithms.mapping.zone_grid import ZoneGrid
from robrain.algorithms.navigation.reservations import ReservedArea, reserved_areas
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.slam.map_patch import map_stamp_ms
from robrain.algorithms.slam.robots_in_scan import robot_circles, sees_through, wall_ends
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.plugins.skill.mapper.closures import ClosureFinder
from robrain.plugins.skill.mapper.frames import Frames
from robrain.plugins.skill.mapper.map_exchange import MapReceiver, MapSender
from robrain.plugins.skill.mapper.own_submaps import OwnSubmaps, SubmapSpec
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.plugins.unit.teammates import TeammatesInterface
from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_CLOSURES, ROBOT_MAP, ROBOT_MAP_WHOLE, Closures
from robrain.protocol.messages.team.zone_messages import COORDINATOR_ZONES
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D
from robrain.protocol.model.grid_geometry import UNKNOWN, GridGeometry
from robrain.protocol.model.map_frame import ARENA, MapFrame
from robrain.protocol.model.ranges import Positive
from robrain.protocol.model.zone import Zone

logger = logging.getLogger(__name__)


class MapCells(msgspec.Struct, frozen=True, eq=False):
    """The map at one moment, for driving: keep-out zones are occupied in it.

    (H, W) classes of `OccupancyGrid`, row 0 at the lowest y, arena frame.
    """

    version: int
    geometry: GridGeometry
    classes: NDArray[np.int8]
    zones: ZoneGrid | None = None
    """The zones that the robot has to obey; None if there are none."""
    seen: NDArray[np.int8] | None = None
    """The classes without zones; None if there are no zones."""
    areas: Sequence[ReservedArea] = ()
    """Zones and doors that the robot reserves before it drives there."""

    def is_unexplored(self, place: Point2D) -> bool:
        """Whether a place, arena frame, lies within the map's borders and has not been seen."""
        row, column = self.geometry.cell_of(place.x_m, place.y_m)
        return self.geometry.contains(row, column) and bool(self.classes[row, column] == UNKNOWN)


class MapperCounters(msgspec.Struct, frozen=True, kw_only=True):
    """Counters of the mapper's input."""

    scans: int
    """Scans put into the map."""
    scans_skipped: int
    """Scans skipped because the robot's place was too uncertain."""
    skip_reason: str
    """Reason why scans are skipped now; empty if they are not."""
    patches_dropped: int
    """Patches of others that came faster than they could be merged."""
    submaps: int
    """Number of submaps of the map."""
    closures: int
    """Number of scans that matched a submap of another robot, or an old one of this robot: loop closures."""
    contradictions: int
    """Number of scans that contradicted a submap that covers the place."""


class MapperInterface(Protocol):
    """The map that the robot and its team have made."""

    def view(self) -> MapCells:
        """The map as it is now; do not write to it."""


START_S = 5.0
"""Seconds after the start in which maps of other robots may show that the start pose is wrong."""
PUBLISH_AFTER_S = 0.5
"""Seconds after the start before the first patch is sent, so that a wrong start pose can be found first."""
CLOSURE_PERIOD_S = 1.0
"""Seconds between two attempts to find a loop closure."""
CLOSURES_A_STEP = 256
"""Largest number of closures in a message."""
SOLVE_PERIOD_S = 2.0
"""Seconds between two solutions of the pose graph."""
SEARCH_PERIOD_S = 0.5
"""Seconds between two searches of a robot that does not know its place on the map of the team."""
WAITING_MAX = 16
"""Number of scans that wait for the odometry and the match of their time."""
ZONE_MESSAGES = 16
"""Messages about zones that wait for a step at most; only the last counts."""
NOBODY = np.empty((0, 3))


class AtlasSkill(Skill):
    """Gives others the map of a team's submaps, with the team's zones; `step` and `activate` are to be called first."""

    interface = MapperInterface
    _atlas: SubmapAtlas
    _view: MapCells | None = None
    _zones: ZoneGrid | None = None
    _areas: Sequence[ReservedArea] = ()
    _zone_changes = 0

    def activate(self) -> None:
        self._zone_list: list[Zone] = []
        self._zone_inbox = Inbox(capacity=ZONE_MESSAGES)
        self.env.wire.subscribe(self._zone_inbox, COORDINATOR_ZONES)

    def step(self) -> None:
        if self._zone_inbox.has_some:
            for received in self._zone_inbox.drain():
                self._obey([zone for zone in received.message.zones if zone.binds(self.env.robot)])

    def _obey(self, zones: list[Zone]) -> None:
        if zones != self._zone_list:
            self._zone_list = zones
            self._zones = ZoneGrid(zones, self._atlas.grid.geometry) if zones else None
            self._areas = reserved_areas(zones)
            self._zone_changes += 1

    def view(self) -> MapCells:
        """The map as it is now."""
        grid, zones = self._atlas.grid, self._zones
        version = grid.version + self._zone_changes
        if self._view is None or self._view.version != version:
            seen = grid.classes()
            if zones is None:
                self._view = MapCells(version, grid.geometry, seen)
            else:
                self._view = MapCells(version, grid.geometry, zones.close(seen), zones, seen, self._areas)
        return self._view

    @external
    def known_area_m2(self) -> float:
        """Known area of floor and walls."""
        grid = self._atlas.grid
        return grid.known_count * grid.geometry.resolution_m**2


class Mapper(AtlasSkill):
    """Maps the lidar's scans, publishes changes, and merges those of other robots."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """The team's grid; each robot of a team must have the same."""

        resolution_m: Positive = 0.1
        origin_x_m: float = -20.0
        origin_y_m: float = -20.0
        width_m: Positive = 40.0
        height_m: Positive = 40.0
        sigma_max_m: Positive = 2.0
        """Standard deviation of the place on the robot's own map, metres, above which scans are not mapped."""

        submap: SubmapSpec = SubmapSpec()
        graph: GraphSpec = GraphSpec()
        closure_slack_m: float = 0.0
        """Metres: smaller offsets of loop closures count as zero. Half a cell suits a base with exact odometry."""

        def geometry(self) -> GridGeometry:
            """The grid that covers this area."""
            return GridGeometry(
                self.resolution_m,
                self.origin_x_m,
                self.origin_y_m,
                max(1, round(self.width_m / self.resolution_m)),
                max(1, round(self.height_m / self.resolution_m)),
            )

    period_s = 0.5
    parameters: Parameters
    paused = Event[str](outside=True)
    """Reason why scans are skipped from now on; empty when they are mapped again."""

    def init(self) -> None:
        self._own_map = self.env.board.shared(OwnMap)
        self._accepted = self._skipped = 0
        geometry = self.parameters.geometry()
        self._atlas = SubmapAtlas(geometry)
        self._graph = SubmapGraph(self.env.robot, self.parameters.graph)
        self._own = OwnSubmaps(geometry, self._graph, self.parameters.submap)
        self._desk = ClosureFinder(self.env.robot, self._graph, self._atlas, self.parameters.closure_slack_m)
        self._frames = Frames(
            self.env.robot, self._atlas, self._graph, self._own, self._robot_places_in, lambda: self._teammates.count()
        )
        self._outgoing = MapSender(self.env.robot, geometry)
        self._incoming = MapReceiver(self.env.robot, self._atlas, self._desk, self._frames)
        self._began_ns: int | None = None
        self._has_restarted = False
        self._waiting: deque[LaserScan] = deque(maxlen=WAITING_MAX)
        self._closure_due_ns = self._solve_due_ns = self._search_due_ns = 0
        self._seen: _Seen | None = None

    def activate(self) -> None:
        super().activate()
        wire, robot = self.env.wire, self.env.robot
        self.env.board.map = self._atlas.grid
        if self._own_map.local_map is not None:
            self._own.T_arena_local = self._own_map.local_map.T_arena_local
        if self._began_ns is None:
            self._began_ns = self.env.clock.now_ns()
            self._incoming.begin(self._began_ns)
        self._driver = self.env.use("driver", DriverInterface)
        self._teammates = self.env.use("teammates", TeammatesInterface)
        self.env.observe(self.env.use("scan", ScanInterface).scanned, self._see)
        self._patches = wire.publisher(ROBOT_MAP, robot=robot)
        self._closures = wire.publisher(ROBOT_CLOSURES, robot=robot)
        self._incoming.connect(wire)
        self.env.answer(ROBOT_MAP_WHOLE, lambda _request: self._incoming.whole(), robot=robot)
        self._publish_others()

    def step(self) -> None:
        super().step()
        self._incoming.step()
        self._publish_move()
        self._own_map.robot_places = self._others()
        self._integrate()
        if self._own_map.false_start:
            self._restart()
        if not self._is_starting(START_S):
            self._incoming.others = None
        self._publish_others()
        self._draw_own_patch()
        self._find_frame()
        self._solve()
        if self._is_starting(PUBLISH_AFTER_S):
            return
        for patch in self._outgoing.drain():
            self._patches.put(patch)
        if self._desk.found:
            self._closures.put(Closures(robot=self.env.robot, closures=self._desk.found[:CLOSURES_A_STEP]))
            self._desk.found.clear()

    @external
    def counters(self) -> MapperCounters:
        """Counters of scans and patches."""
        return MapperCounters(
            scans=self._accepted,
            scans_skipped=self._skipped,
            skip_reason=self.env.board.map_paused,
            patches_dropped=self._incoming.dropped,
            submaps=len(self._atlas.submaps),
            closures=self._desk.closed,
            contradictions=self._desk.contradicted,
        )

    def _see(self, scan: LaserScan) -> None:
        self._waiting.append(scan)
        self._integrate()

    def _integrate(self) -> None:
        """Map the waiting scans whose pose is now known."""
        while self._waiting and (local_pose := self._own_map.local_pose) is not None:
            stamp_ns = self._waiting[0].stamp_ns
            if stamp_ns > local_pose.until_ns or stamp_ns > self._driver.odometry_until_ns():
                return
            scan = self._waiting.popleft()
            # An unmatched scan could be of another place, to which a person has carried the robot.
            if local_pose.checked is None or scan.stamp_ns in local_pose.checked:
                self._handle_scan(scan, local_pose)

    def _handle_scan(self, scan: LaserScan, local_pose: LocalPose) -> None:
        if self._own_map.false_start:
            self._restart()
        self._pause(self._refusal(local_pose))
        if self.env.board.map_paused:
            self._skipped += 1
            return
        if not local_pose.fits:
            self._skipped += 1
            return
        self._accepted += 1
        if local_pose.trajectory != self._own.trajectory:
            self._own.begin_trajectory(local_pose.trajectory)
            if local_pose.lost:
                self._own.T_arena_local = IDENTITY
            self._desk.restart()
            self._frames.begin(map_stamp_ms(scan.stamp_ns), local_pose.lost)
        local = local_pose.T_local_odom.compose(self._driver.pose_at(scan.stamp_ns))
        self._own_map.robot_places = reported = self._others()
        sensor = self._own.T_arena_local.compose(local)
        circles = robot_circles(scan.angles_rad, scan.ranges_m, scan.range_max_m, sensor, reported)
        if self._own.is_over():
            self._finish_submap()
            covariance = np.array(self.env.board.pose_covariance).reshape(3, 3)
            self._own.begin_submap(map_stamp_ms(scan.stamp_ns), local, local_pose.drift, covariance)
            self._withdraw_covered()
        self._own.integrate(
            local,
            scan.angles_rad,
            scan.ranges_m,
            scan.range_max_m,
            map_stamp_ms(scan.stamp_ns),
            _in_local(circles, self._own.T_arena_local),
            local_pose.drift,
        )
        self._update_board()
        self._search_closure(scan, local, circles)
        self._seen = _Seen(scan, local)

    def _draw_own_patch(self) -> None:
        """Draw the robot's observations, and queue the patch."""
        self._own.contradict(self._atlas.grid)
        own = self._own.pop_patch()
        if own is None:
            return
        key = (self.env.robot, own.submap)
        if key not in self._atlas.submaps:
            self._atlas.move(key, self._own.T_arena_local, self._own.frame)
        self._atlas.merge(key, own.cells.row, own.cells.column, own.cells.cells, own.cells.stamp_ms)
        self._outgoing.patch(own, self._own)

    def _finish_submap(self) -> None:
        """Queue the last patch of the current submap, and its surfaces."""
        self._draw_own_patch()
        number = self._own.number
        if number is None:
            return
        surfaces = self._own.surfaces()
        self._atlas.set_surfaces((self.env.robot, number), surfaces)
        self._outgoing.finished(number, self._own, surfaces)

    def _search_closure(self, scan: LaserScan, local: Pose2D, circles: Floats) -> None:
        now_ns, number = self.env.clock.now_ns(), self._own.number
        if now_ns < self._closure_due_ns or number is None:
            return
        sensor = self._own.T_arena_local.compose(local)

        def points() -> Floats:
            return wall_ends(scan.angles_rad, scan.ranges_m, scan.range_max_m, sensor, circles)

        if self._desk.check(number, local, sensor, points, self.env.board.pose_covariance):
            self._closure_due_ns = now_ns + to_ns(CLOSURE_PERIOD_S)

    def _solve(self) -> None:
        now_ns = self.env.clock.now_ns()
        if not self._graph.has_news or now_ns < self._solve_due_ns:
            return
        self._solve_due_ns = now_ns + to_ns(SOLVE_PERIOD_S)
        moved = self._graph.solve(self._atlas.place_of, self._desk.variances_of)
        if not moved:
            return
        nodes = [self._graph.own[number] for number in moved]
        for frame in sorted({node.frame for node in nodes}):
            placed = {(self.env.robot, node.number): node.T_arena_local for node in nodes if node.frame == frame}
            self._atlas.move_all(placed, frame)
        self._outgoing.placed(nodes)
        current = self._graph.current
        if current is not None and current.number == self._own.number:
            self._own.T_arena_local = current.T_arena_local
            self._update_board()

    def _update_board(self) -> None:
        self._own_map.local_map, self.env.board.frame = self._own.local_map(), self._own.frame

    def _find_frame(self) -> None:
        """Search for the team's map frame if the robot is not in it; leave it if the robot lies wrong there."""
        now_ns = self.env.clock.now_ns()
        if reason := self._desk.misplacement_reason():
            # Somewhere in this trajectory is a break, as when a person has carried the robot off unnoticed.
            nodes = self._graph.own.values()
            self._withdraw([node.number for node in nodes if node.trajectory == self._own.trajectory])
            self._own.begin_trajectory(self._own.trajectory)
            self._own_map.misplaced = reason
        elif reason := self._frames.uncertainty_reason():
            self._frames.part(reason)
        fix, self._own_map.arena_fix = self._own_map.arena_fix, None
        if fix is not None:
            self._frames.apply_fix(fix)
        is_due = self._frames.frame != ARENA and now_ns >= self._search_due_ns and self._own.number is not None
        if is_due and self._seen is not None:
            self._search_due_ns = now_ns + to_ns(SEARCH_PERIOD_S)
            self._frames.search(self._own.T_arena_local.compose(self._seen.local), self._may_be_at)
        self._publish_move()

    def _publish_move(self) -> None:
        """Submaps have changed their frame: inform the team and localisation."""
        if not self._frames.outgoing:
            return
        self._outgoing.moved(self._frames.outgoing)
        self._frames.outgoing = []
        self._update_board()
        self._own_map.robot_places = self._others()

    def _may_be_at(self, frame: MapFrame, pose: Pose2D) -> bool:
        """Whether motes and the teammates of a frame allow the robot to be at a pose of it."""
        if frame == ARENA and not self._own_map.may_be_at(pose):
            return False
        if self._seen is None:
            return True
        scan = self._seen.scan
        return not sees_through(scan.angles_rad, scan.ranges_m, scan.range_max_m, pose, self._robot_places_in(frame))

    def _refusal(self, local_pose: LocalPose) -> str:
        """Reason why a scan must not be mapped now; walls in the wrong place are worse than none.

        The uncertainty of the place of the robot's own map does not count. Loop closures move submaps as a whole, and
        only a robot that maps finds any.
        """
        board = self.env.board
        if self._own_map.misplaced:
            return self._own_map.misplaced
        if board.lost and not local_pose.lost:
            return f"the robot does not know where it is: {board.lost}"
        # With some slack, so that it does not go on and off.
        limit_m = self.parameters.sigma_max_m * (0.8 if self.env.board.map_paused else 1.0)
        if local_pose.sigma_m > limit_m:
            return f"the robot's place is not sure enough, above {limit_m:g} m"
        return ""

    def _publish_others(self) -> None:
        """Share the earlier map of the others, by which localisation checks the robot's start."""
        others = self._incoming.others
        self._own_map.map_of_others = None if others is None else others.grid

    def _is_starting(self, for_s: float) -> bool:
        return self.env.clock.now_ns() - (self._began_ns or 0) < to_ns(for_s)

    def _restart(self) -> None:
        """Withdraw submaps mapped from a wrong start pose."""
        if not self._has_restarted:
            self._has_restarted = True
            self._withdraw(list(self._graph.own))
            self._own.begin_trajectory(self._own.trajectory)

    def _withdraw_covered(self) -> None:
        """Remove fixed own submaps that the map no longer shows: otherwise maps grow for ever.

        The last of them stays: the oldest one that can be moved is placed relative to it.
        """
        robot, movable = self.env.robot, self._graph.own
        fixed = sorted(number for name, number in self._atlas.submaps if name == robot and number not in movable)
        self._withdraw([number for number in fixed[:-1] if self._atlas.is_covered(self._atlas.submaps[robot, number])])

    def _withdraw(self, numbers: list[int]) -> None:
        """Remove own submaps, and queue the message about it."""
        for number in numbers:
            self._graph.withdraw(number)
            self._atlas.withdraw((self.env.robot, number))
        self._incoming.withdrawn.update(numbers)
        self._outgoing.withdrawn(numbers)

    def _pause(self, reason: str) -> None:
        if bool(reason) != bool(self.env.board.map_paused):
            logger.warning("%s: the mapper %s", self.env.robot, f"leaves scans out: {reason}" if reason else "goes on")
            self.paused.notify(reason)
        self.env.board.map_paused = reason

    def _others(self) -> Floats:
        """(K, 3) published places of teammates and their radii, metres, in the robot's map frame."""
        return self._robot_places_in(self._own.frame)

    def _robot_places_in(self, frame: MapFrame) -> Floats:
        """(K, 3) published places of teammates in a map frame and their radii, metres."""
        teammates = self._teammates.in_frame(frame)
        if not teammates:
            return NOBODY
        return np.array([(teammate.pose.x_m, teammate.pose.y_m, teammate.radius_m) for teammate in teammates])


class _Seen(NamedTuple):
    """The last scan that was mapped."""

    scan: LaserScan
    local: Pose2D
    """T_local_sensor."""


def _in_local(circles: Floats, T_arena_local: Pose2D) -> Floats:
    """Circles of the arena frame in the frame `local`."""
    if T_arena_local == IDENTITY or not len(circles):
        return circles
    T_local_arena = T_arena_local.inverse()
    cos, sin = math.cos(T_local_arena.yaw_rad), math.sin(T_local_arena.yaw_rad)
    moved = circles.copy()
    moved[:, 0] = T_local_arena.x_m + cos * circles[:, 0] - sin * circles[:, 1]
    moved[:, 1] = T_local_arena.y_m + sin * circles[:, 0] + cos * circles[:, 1]
    return moved
