"""Mapper: an occupancy grid from the robot's own scans and from the patches of the others."""

import logging
import math
from collections import deque

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.agent.event import Event
from robrain.agent.plugin import Skill, external
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.plugins.skill.mapper.closures import ClosureDesk
from robrain.plugins.skill.mapper.interface import MapperCounters, MapperInterface, MapView
from robrain.plugins.skill.mapper.own_submaps import OwnSubmaps, SubmapSpec
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.plugins.unit.teammates.interface import TeammatesInterface
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.local_map import LocalPose
from robrain.protocol.model.mapping.mates_in_scan import mate_circles, outside
from robrain.protocol.model.mapping.submap import IDENTITY
from robrain.protocol.model.mapping.submap_atlas import SubmapAtlas, SubmapKey
from robrain.protocol.model.mapping.submap_graph import GraphSpec, SubmapGraph
from robrain.protocol.model.occupancy_grid import GridGeometry
from robrain.protocol.model.scan_match import beam_ends
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.inbox import Inbox, Received
from robrain.protocol.wire.map_messages import Closures, MapPatch
from robrain.protocol.wire.map_patch import (
    check_claim,
    joined_message,
    map_stamp_ms,
    pose_message,
    take_message,
    to_message,
    whole_map,
)
from robrain.protocol.wire.record_guard import RecordGuard
from robrain.protocol.wire.refusals import RefusalCode
from robrain.protocol.wire.topics import ROBOT_ALIVE, ROBOT_CLOSURES, ROBOT_MAP, ROBOT_MAP_WHOLE

logger = logging.getLogger(__name__)

START_S = 5.0
"""What the others send in this time after the start may still show that the robot is not where it was told it is."""
WHOLE_MS = 400
"""So long after the start the others' answers with their whole maps may be made; less than `TELL_AFTER_S`."""
TELL_AFTER_S = 0.5
"""Until then nobody is told of what was mapped; chosen."""
CLOSURE_PERIOD_S = 1.0
"""A scan is laid on another submap this often."""
CLOSURES_A_STEP = 256
SOLVE_PERIOD_S = 2.0
WAITING_MAX = 16
"""Scans that wait until it is known where the robot was."""
NOBODY = np.empty((0, 3))


class Mapper(Skill):
    """Maps what the lidar sees, tells the team what changed, and takes in what the team tells."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """The team's grid; each robot of a team must have the same."""

        resolution_m: float = 0.1
        origin_x_m: float = -20.0
        origin_y_m: float = -20.0
        width_m: float = 40.0
        height_m: float = 40.0
        sigma_max_m: float = 2.0
        """Scans are left out while the robot's place on its own map is less sure than this; chosen."""

        def __post_init__(self) -> None:
            for name in ("resolution_m", "width_m", "height_m", "sigma_max_m"):
                if getattr(self, name) <= 0:
                    raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")

        submap: SubmapSpec = SubmapSpec()
        graph: GraphSpec = GraphSpec()
        closure_slack_m: float = 0.0
        """Loop closures that are off by less are taken for none: half a cell for a base whose odometry is exact."""

        def geometry(self) -> GridGeometry:
            """The grid that covers this area."""
            return GridGeometry(
                self.resolution_m,
                self.origin_x_m,
                self.origin_y_m,
                max(1, round(self.width_m / self.resolution_m)),
                max(1, round(self.height_m / self.resolution_m)),
            )

    interface = MapperInterface
    period_s = 0.5
    parameters: Parameters
    paused = Event[str](outside=True)
    """Why scans are left out, from now on; empty when they are taken in again."""

    def init(self) -> None:
        self._why_paused = ""
        self._taken = self._left_out = 0
        geometry = self.parameters.geometry()
        self._atlas = SubmapAtlas(geometry)
        self._graph = SubmapGraph(self.env.robot, self.parameters.graph)
        self._own = OwnSubmaps(geometry, self._graph, self.parameters.submap)
        self._desk = ClosureDesk(self.env.robot, self._graph, self._atlas, self.parameters.closure_slack_m)
        self._view: MapView | None = None
        self._inbox = Inbox(capacity=4096)
        self._refused: set[str] = set()
        self._met: set[str] = set()
        """Robots whose liveliness token has been seen."""
        self._orphans: set[SubmapKey] = set()
        """Submaps of robots that have gone since."""
        self._began_ns: int | None = None
        self._has_begun_anew = False
        self._waiting: deque[LaserScan] = deque(maxlen=WAITING_MAX)
        self._untold: list[MapPatch] = []
        self._closure_due_ns = self._solve_due_ns = 0

    def activate(self) -> None:
        wire, robot = self.env.wire, self.env.robot
        self.env.board.map = self._atlas.grid
        if self.env.board.local_map is not None:
            self._own.T_arena_local = self.env.board.local_map.T_arena_local
        if self._began_ns is None:
            self._began_ns = self.env.clock.now_ns()
            self._others: SubmapAtlas | None = SubmapAtlas(self._atlas.grid.geometry)
            self.env.board.map_of_others = self._others.grid
        self._driver = self.env.use("driver", DriverInterface)
        self._teammates = self.env.use("teammates", TeammatesInterface)
        self.env.observe(self.env.use("scan", ScanInterface).scanned, self._see)
        self._guard = RecordGuard(wire.refusals)
        self._patches = wire.publisher(ROBOT_MAP, robot=robot)
        self._closures = wire.publisher(ROBOT_CLOSURES, robot=robot)
        self._presence = wire.watch(ROBOT_ALIVE)
        wire.subscribe(self._inbox, ROBOT_MAP)
        wire.subscribe(self._inbox, ROBOT_CLOSURES)
        self.env.answer(ROBOT_MAP_WHOLE, lambda _request: self._whole(), robot=robot)

    def step(self) -> None:
        self._hear()
        self.env.board.mate_places = self._mates()
        self._integrate()
        if self.env.board.false_start:
            self._begin_anew()
        if not self._is_starting(START_S):
            self._others = self.env.board.map_of_others = None
        self._take_own_patch()
        self._solve()
        if self._is_starting(TELL_AFTER_S):
            return
        for patch in self._untold:
            self._patches.put(patch)
        self._untold.clear()
        if self._desk.found:
            self._closures.put(Closures(robot=self.env.robot, closures=self._desk.found[:CLOSURES_A_STEP]))
            self._desk.found.clear()

    def view(self) -> MapView:
        """The map as it is now."""
        grid = self._atlas.grid
        if self._view is None or self._view.version != grid.version:
            self._view = MapView(grid.version, grid.geometry, grid.classes())
        return self._view

    @external
    def known_area_m2(self) -> float:
        """Area of the floor and walls that are known."""
        grid = self._atlas.grid
        return grid.known_count * grid.geometry.resolution_m**2

    @external
    def counters(self) -> MapperCounters:
        """What became of scans and patches so far."""
        return MapperCounters(
            scans=self._taken,
            scans_left_out=self._left_out,
            why_left_out=self._why_paused,
            patches_dropped=self._inbox.dropped,
            submaps=len(self._atlas.submaps),
            closures=self._desk.closed,
            contradictions=self._desk.contradicted,
        )

    def _see(self, scan: LaserScan) -> None:
        self._waiting.append(scan)
        self._integrate()

    def _integrate(self) -> None:
        """Take in the scans for which it is known by now where the robot was."""
        if not self._waiting:
            return
        until_ns = self._driver.odometry_until_ns()
        while self._waiting and (local_pose := self.env.board.local_pose) is not None:
            if self._waiting[0].stamp_ns > min(until_ns, local_pose.until_ns):
                return
            self._take_scan(self._waiting.popleft(), local_pose)

    def _take_scan(self, scan: LaserScan, local_pose: LocalPose) -> None:
        if self.env.board.false_start:
            self._begin_anew()
        self._pause(self._why_not(local_pose))
        if self._why_paused:
            self._left_out += 1
            return
        if not local_pose.fits:
            self._left_out += 1
            return
        self._taken += 1
        if local_pose.trajectory != self._own.trajectory:
            self._own.begin_trajectory(local_pose.trajectory)
            self._desk.search.forget()
        local = local_pose.T_local_odom.compose(self._driver.pose_at(scan.stamp_ns))
        self.env.board.mate_places = told = self._mates()
        sensor = self._own.T_arena_local.compose(local)
        circles = mate_circles(scan.angles_rad, scan.ranges_m, scan.range_max_m, sensor, told)
        if self._own.is_over():
            self._finish_submap()
            covariance = np.array(self.env.board.pose_covariance).reshape(3, 3)
            self._own.begin_submap(map_stamp_ms(scan.stamp_ns), local, local_pose.drift, covariance)
        self._own.integrate(
            local,
            scan.angles_rad,
            scan.ranges_m,
            scan.range_max_m,
            map_stamp_ms(scan.stamp_ns),
            _in_local(circles, self._own.T_arena_local),
            local_pose.drift,
        )
        self.env.board.local_map = self._own.local_map()
        self._look_for_closure(scan, local, circles)

    def _take_own_patch(self) -> None:
        """Draw what the robot has seen, and have it told."""
        self._own.contradict(self._atlas.grid)
        own = self._own.take_patch()
        if own is None:
            return
        key = (self.env.robot, own.submap)
        if key not in self._atlas.submaps:
            self._atlas.move(key, self._own.T_arena_local)
        self._atlas.take(key, own.cells.row, own.cells.column, own.cells.cells, own.cells.stamp_ms)
        geometry = self._atlas.grid.geometry
        self._untold.append(to_message(self.env.robot, geometry, own.cells, own.submap, self._own.T_arena_local))

    def _finish_submap(self) -> None:
        """What is left to tell of the current submap, and where in their cells its walls are."""
        self._take_own_patch()
        number = self._own.number
        if number is None:
            return
        surfaces = self._own.surfaces()
        self._atlas.take_surfaces((self.env.robot, number), surfaces)
        geometry = self._atlas.grid.geometry
        self._untold.append(pose_message(self.env.robot, geometry, number, self._own.T_arena_local, surfaces=surfaces))

    def _look_for_closure(self, scan: LaserScan, local: Pose2D, circles: NDArray[np.float64]) -> None:
        now_ns, number = self.env.clock.now_ns(), self._own.number
        if now_ns < self._closure_due_ns or number is None:
            return
        sensor = self._own.T_arena_local.compose(local)
        points = outside(beam_ends(scan.angles_rad, scan.ranges_m, scan.range_max_m), sensor, circles)
        if self._desk.look(number, local, sensor, points, self.env.board.pose_covariance):
            self._closure_due_ns = now_ns + to_ns(CLOSURE_PERIOD_S)

    def _solve(self) -> None:
        now_ns = self.env.clock.now_ns()
        if not self._graph.has_news or now_ns < self._solve_due_ns:
            return
        self._solve_due_ns = now_ns + to_ns(SOLVE_PERIOD_S)
        moved = self._graph.solve(self._desk.place_of, self._desk.variances_of)
        if not moved:
            return
        robot, geometry = self.env.robot, self._atlas.grid.geometry
        told = []
        for number, T_arena_local in moved.items():
            self._atlas.move((robot, number), T_arena_local)
            covariance = self._graph.own[number].covariance
            variances = max(covariance[0, 0], covariance[1, 1]), covariance[2, 2]
            told.append(pose_message(robot, geometry, number, T_arena_local, variances=variances))
        self._untold.append(joined_message(robot, geometry, told))
        current = self._graph.current
        if current is not None and current.number == self._own.number:
            self._own.T_arena_local = current.T_arena_local
            self.env.board.local_map = self._own.local_map()

    def _why_not(self, local_pose: LocalPose) -> str:
        """Why a scan must not be put into the map now; walls in the wrong place are worse than none.

        How unsure it is where the robot's own map lies does not count: loop closures move submaps as a whole, and only
        a robot that maps finds any.
        """
        board = self.env.board
        if board.lost:
            return f"the robot does not know where it is: {board.lost}"
        # With some slack, so that it does not go on and off.
        limit_m = self.parameters.sigma_max_m * (0.8 if self._why_paused else 1.0)
        if local_pose.sigma_m > limit_m:
            return f"the robot's place is not sure enough, above {limit_m:g} m"
        return ""

    def _is_starting(self, for_s: float) -> bool:
        return self.env.clock.now_ns() - (self._began_ns or 0) < to_ns(for_s)

    def _begin_anew(self) -> None:
        """Throw away what was mapped from where the robot never was."""
        if self._has_begun_anew:
            return
        self._has_begun_anew = True
        self._withdraw(list(self._graph.own))

    def _withdraw(self, numbers: list[int]) -> None:
        """Own submaps are wrong: leave them out of the map, and tell so."""
        robot, geometry = self.env.robot, self._atlas.grid.geometry
        told = []
        for number in numbers:
            self._graph.withdraw(number)
            self._atlas.withdraw((robot, number))
            told.append(pose_message(robot, geometry, number, IDENTITY, withdrawn=True))
        self._untold = [each for each in self._untold if each.submap not in numbers or each.parts]
        if told:
            self._untold.append(joined_message(robot, geometry, told))
        self._own.begin_trajectory(self._own.trajectory)

    def _pause(self, why: str) -> None:
        if bool(why) != bool(self._why_paused):
            logger.warning("%s: the mapper %s", self.env.robot, f"leaves scans out: {why}" if why else "goes on")
            self.paused.notify(why)
        self._why_paused = why

    def _mates(self) -> NDArray[np.float64]:
        """(K, 3) where mates say that they are, and their radii, arena frame."""
        others = self._teammates.others()
        if not others:
            return NOBODY
        return np.array([(mate.pose.x_m, mate.pose.y_m, mate.radius_m) for mate in others])

    def _hear(self) -> None:
        for change in self._presence.changes():
            name = change.names["robot"]
            self._met.add(name)
            if not change.present:
                # A process that takes its name begins anew, and knows nothing of these.
                self._orphans.update(key for key in self._atlas.submaps if key[0] == name)
            if change.present and name != self.env.robot:
                # Catch up with a robot that was there before; one that has just started has nothing to tell.
                self.env.wire.ask_into(self._inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=name)
        self._guard.messages(self._inbox.drain(), self._take)

    def _take(self, received: Received) -> None:
        message: MapPatch | Closures = received.message
        if message.robot == self.env.robot:
            return
        if message.robot not in self._met:
            # nothing is lost: the mapper asks for its whole map when its token appears
            why = f"{message.robot} is not there"
            self.env.wire.refusals.note(received.topic.name, received.key, RefusalCode.UNKNOWN_SENDER, why)
        elif isinstance(message, Closures):
            self._desk.hear(message)
        else:
            self._merge(message)

    def _merge(self, patch: MapPatch) -> None:
        try:
            check_claim(patch, self.env.clock.now_ns())
            take_message(self._atlas, patch)
            if self._others is not None:
                began_ms = map_stamp_ms(self._began_ns or 0)
                before = tuple(part for part in patch.parts if _was_before(part, began_ms))
                take_message(self._others, msgspec.structs.replace(patch, parts=before, rows=0, columns=0, cells=b""))
        except ValueError as error:
            if patch.robot not in self._refused:
                self._refused.add(patch.robot)
                logger.warning("%s: the map of %s cannot be merged: %s", self.env.robot, patch.robot, error)
            return
        self._desk.hear_places(patch)

    def _whole(self) -> MapPatch | None:
        """The robot's own submaps, and those of robots that are not there to tell them."""
        robot = self.env.robot
        others = self._met - {robot}
        keys = [key for key in sorted(self._atlas.submaps) if key[0] not in others or key in self._orphans]
        return whole_map(robot, self._atlas, keys)


def _was_before(part: MapPatch, began_ms: int) -> bool:
    """Whether a submap was begun before then, and tells what was seen until about then."""
    return part.submap < began_ms and part.observed_ms <= began_ms + WHOLE_MS


def _in_local(circles: NDArray[np.float64], T_arena_local: Pose2D) -> NDArray[np.float64]:
    """Circles of the arena frame in the frame `local`."""
    if T_arena_local == IDENTITY or not len(circles):
        return circles
    T_local_arena = T_arena_local.inverse()
    cos, sin = math.cos(T_local_arena.yaw_rad), math.sin(T_local_arena.yaw_rad)
    moved = circles.copy()
    moved[:, 0] = T_local_arena.x_m + cos * circles[:, 0] - sin * circles[:, 1]
    moved[:, 1] = T_local_arena.y_m + sin * circles[:, 0] + cos * circles[:, 1]
    return moved
