"""Mapper: an occupancy grid from the robot's own scans and from the patches of the others."""

import logging
import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.agent.event import Event
from robrain.agent.plugin import Skill, external
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.plugins.skill.mapper.interface import MapperCounters, MapperInterface, MapView
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.plugins.unit.teammates.interface import TeammatesInterface
from robrain.protocol.model.occupancy_grid import GridGeometry, OccupancyGrid
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.inbox import Inbox, Received
from robrain.protocol.wire.map_patch import check_claim, map_stamp_ms, merge_message, to_message
from robrain.protocol.wire.messages import MapPatch
from robrain.protocol.wire.record_guard import RecordGuard
from robrain.protocol.wire.refusals import RefusalCode
from robrain.protocol.wire.topics import ROBOT_ALIVE, ROBOT_MAP, ROBOT_MAP_WHOLE

logger = logging.getLogger(__name__)

START_S = 5.0
"""What the others send in this time after the start may still show that the robot is not where it was told it is."""
TELL_AFTER_S = 0.5
"""Until then nobody is told of what was mapped; chosen."""
TEAMMATE_MARGIN_M = 0.15
"""A return this close to a teammate is the teammate, not a wall."""


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
        """Scans are left out while the robot's place is less sure than this; chosen."""

        def __post_init__(self) -> None:
            for name in ("resolution_m", "width_m", "height_m", "sigma_max_m"):
                if getattr(self, name) <= 0:
                    raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")

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
        self._grid = OccupancyGrid(self.parameters.geometry())
        self._view: MapView | None = None
        self._inbox = Inbox(capacity=4096)
        self._refused: set[str] = set()
        self._met: set[str] = set()
        """Robots whose liveliness token has been seen."""
        self._began_ns: int | None = None
        self._has_begun_anew = False

    def activate(self) -> None:
        wire, robot = self.env.wire, self.env.robot
        self.env.board.map = self._grid
        if self._began_ns is None:
            self._began_ns = self.env.clock.now_ns()
            self.env.board.map_of_others = OccupancyGrid(self._grid.geometry)
        self._driver = self.env.use("driver", DriverInterface)
        self._teammates = self.env.use("teammates", TeammatesInterface)
        self.env.observe(self.env.use("scan", ScanInterface).scanned, self._integrate)
        self._guard = RecordGuard(wire.refusals)
        self._patches = wire.publisher(ROBOT_MAP, robot=robot)
        self._presence = wire.watch(ROBOT_ALIVE)
        wire.subscribe(self._inbox, ROBOT_MAP)
        self.env.answer(ROBOT_MAP_WHOLE, lambda _request: self._whole(), robot=robot)

    def step(self) -> None:
        self._hear()
        if self.env.board.false_start:
            self._begin_anew()
        if not self._is_starting(START_S):
            self.env.board.map_of_others = None
        if self._is_starting(TELL_AFTER_S):
            return
        patch = self._grid.take_patch()
        if patch is not None:
            self._patches.put(to_message(self.env.robot, self._grid.geometry, patch))

    def view(self) -> MapView:
        """The map as it is now."""
        if self._view is None or self._view.version != self._grid.version:
            self._view = MapView(self._grid.version, self._grid.geometry, self._grid.classes())
        return self._view

    @external
    def known_area_m2(self) -> float:
        """Area of the floor and walls that are known."""
        return self._grid.known_count * self._grid.geometry.resolution_m**2

    @external
    def counters(self) -> MapperCounters:
        """What became of scans and patches so far."""
        return MapperCounters(
            scans=self._taken,
            scans_left_out=self._left_out,
            why_left_out=self._why_paused,
            patches_dropped=self._inbox.dropped,
        )

    def _integrate(self, scan: LaserScan) -> None:
        T_arena_odom = self.env.board.T_arena_odom
        if T_arena_odom is None:
            return
        if self.env.board.false_start:
            self._begin_anew()
        self._pause(self._why_not())
        if self._why_paused:
            self._left_out += 1
            return
        self._taken += 1
        sensor = T_arena_odom.compose(self._driver.pose_at(scan.stamp_ns))
        self._grid.integrate_scan(
            sensor, scan.angles_rad, scan.ranges_m, scan.range_max_m, map_stamp_ms(scan.stamp_ns), self._team_circles()
        )

    def _why_not(self) -> str:
        """Why a scan must not be put into the map now; walls in the wrong place are worse than none."""
        board = self.env.board
        if board.lost:
            return f"the robot does not know where it is: {board.lost}"
        covariance = board.pose_covariance
        sigma_m = math.sqrt(max(covariance[0], covariance[4])) if covariance else 0.0
        # With some slack, so that it does not go on and off.
        limit_m = self.parameters.sigma_max_m * (0.8 if self._why_paused else 1.0)
        if sigma_m > limit_m:
            return f"the robot's place is not sure enough, above {limit_m:g} m"
        return ""

    def _is_starting(self, for_s: float) -> bool:
        return self.env.clock.now_ns() - (self._began_ns or 0) < to_ns(for_s)

    def _begin_anew(self) -> None:
        """Throw away what was mapped from where the robot never was."""
        others = self.env.board.map_of_others
        if others is None or self._has_begun_anew:
            return
        self._has_begun_anew = True
        self._grid.forget()
        whole = others.full_patch()
        if whole is not None:
            self._grid.merge_patch(whole.row, whole.column, whole.cells, whole.stamp_ms)

    def _pause(self, why: str) -> None:
        if bool(why) != bool(self._why_paused):
            logger.warning("%s: the mapper %s", self.env.robot, f"leaves scans out: {why}" if why else "goes on")
            self.paused.notify(why)
        self._why_paused = why

    def _team_circles(self) -> NDArray[np.float64]:
        others = self._teammates.others()
        if not others:
            return np.empty((0, 3))
        return np.array([(mate.pose.x_m, mate.pose.y_m, mate.radius_m + TEAMMATE_MARGIN_M) for mate in others])

    def _hear(self) -> None:
        for change in self._presence.changes():
            name = change.names["robot"]
            self._met.add(name)
            if change.present and name != self.env.robot:
                # Catch up with a robot that was there before; one that has just started has nothing to tell.
                self.env.wire.ask_into(self._inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=name)
        self._guard.messages(self._inbox.drain(), self._take)

    def _take(self, received: Received) -> None:
        patch: MapPatch = received.message
        if patch.robot == self.env.robot:
            return
        if patch.robot in self._met:
            self._merge(patch)
        else:  # nothing is lost: the mapper asks for its whole map when its token appears
            why = f"{patch.robot} is not there"
            self.env.wire.refusals.note(ROBOT_MAP.name, received.key, RefusalCode.UNKNOWN_SENDER, why)

    def _merge(self, patch: MapPatch) -> None:
        others = self.env.board.map_of_others
        try:
            check_claim(patch, self.env.clock.now_ns())
            merge_message(self._grid, patch)
            if others is not None and patch.observed_ms <= map_stamp_ms(self._began_ns or 0):
                merge_message(others, patch)
        except ValueError as error:
            if patch.robot not in self._refused:
                self._refused.add(patch.robot)
                logger.warning("%s: the map of %s cannot be merged: %s", self.env.robot, patch.robot, error)

    def _whole(self) -> MapPatch | None:
        patch = self._grid.full_patch()
        return None if patch is None else to_message(self.env.robot, self._grid.geometry, patch)
