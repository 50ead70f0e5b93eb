"""Mapper of a point: rays without noise on the true floor, in one submap that never moves."""

import math
from typing import Any

import msgspec
import numpy as np

from robrain.agent.event import Event
from robrain.agent.plugin import external
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid, PatchCells
from robrain.algorithms.slam.map_patch import in_own_time, map_stamp_ms, merge_message, to_message, whole_map
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.plugins.skill.mapper.mapper import AtlasSkill, Mapper, MapperCounters
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE, MapPatch
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.refusals import RefusalCode
from robrain.protocol.wire.endpoint import Request
from robrain.sim.points.point_team import POINT_TICK_S, robot_of

SEEN_EVERY_M = 0.1
"""Length of the path between two turns of the lidar."""
NO_CIRCLES = np.empty((0, 3))


class PointMapper(AtlasSkill):
    """Reveals the floor around the robot, and merges the areas that the others have revealed."""

    class Parameters(Mapper.Parameters, frozen=True, forbid_unknown_fields=True):
        """As those of the stock mapper, whose grid they give."""

        known: bool = False
        """Whether the robot has the map of the whole floor from the start."""

    period_s = POINT_TICK_S
    parameters: Parameters
    paused = Event[str](outside=True)

    def init(self) -> None:
        self._robot = robot_of(self.env)
        geometry = self.parameters.geometry()
        self._atlas = SubmapAtlas(geometry)
        self._own = OccupancyGrid(geometry)
        self._inbox = Inbox(capacity=4096)
        self._number = map_stamp_ms(self.env.clock.now_ns())
        """Of the robot's submap."""
        self._scans = 0
        self._seen_m: float | None = None
        """Length of the path at the last scan."""
        lidar = self._robot.lidar
        self._angles_rad = np.linspace(-math.pi, math.pi, lidar.rays, endpoint=False)

    def activate(self) -> None:
        super().activate()
        wire, robot = self.env.wire, self.env.robot
        self.env.board.map = self._atlas.grid
        self._patches = wire.publisher(ROBOT_MAP, robot=robot)
        self._presence = wire.watch(ROBOT_ALIVE)
        if self.parameters.known:
            self._publish(PatchCells(0, 0, self._robot.floor.classes(self._own.geometry), self._stamp_ms))
        else:
            wire.subscribe(self._inbox, ROBOT_MAP)
            self._scan()
        self.env.answer(ROBOT_MAP_WHOLE, self._whole, robot=robot)

    def step(self) -> None:
        super().step()
        if self.parameters.known:
            return
        for change in self._presence.changes():
            name = change.names["robot"]
            if change.present and name != self.env.robot:
                self.env.wire.ask_into(self._inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=name)
        self._receive()
        self._scan()

    @external
    def counters(self) -> MapperCounters:
        """Counters of scans and patches."""
        return MapperCounters(
            scans=self._scans,
            scans_skipped=0,
            skip_reason="",
            patches_dropped=self._inbox.dropped,
            submaps=len(self._atlas.submaps),
            closures=0,
            contradictions=0,
        )

    @property
    def _stamp_ms(self) -> int:
        return map_stamp_ms(self.env.clock.now_ns())

    def _receive(self) -> None:
        wire = self.env.wire
        for received in self._inbox.drain():
            patch: MapPatch = received.message
            if patch.robot == self.env.robot:
                continue
            try:
                merge_message(self._atlas, in_own_time(patch, wire.clock.now_ns()))
            except ValueError as error:
                wire.refusals.record(received.topic.name, received.key, RefusalCode.NOT_PLAUSIBLE, str(error))

    def _scan(self) -> None:
        robot = self._robot
        if self._seen_m is not None and robot.distance_m - self._seen_m < SEEN_EVERY_M:
            return
        self._seen_m = robot.distance_m
        self._scans += 1
        range_max_m = robot.lidar.range_max_m
        ranges_m = robot.floor.ranges_m(robot.pose, self._angles_rad, range_max_m)
        self._own.integrate_scan(robot.pose, self._angles_rad, ranges_m, range_max_m, self._stamp_ms, NO_CIRCLES)
        patch = self._own.pop_patch()
        if patch is not None:
            self._publish(patch)

    def _publish(self, patch: PatchCells) -> None:
        """Merge the area that the robot has seen, and publish it."""
        self._atlas.merge((self.env.robot, self._number), patch.row, patch.column, patch.cells, patch.stamp_ms)
        self._patches.put(to_message(self.env.robot, self._own.geometry, patch, self._number))

    def _whole(self, _request: Request[Any]) -> MapPatch | None:
        own = [key for key in self._atlas.submaps if key[0] == self.env.robot]
        message = whole_map(self.env.robot, self._atlas, own)
        return message and msgspec.structs.replace(message, stamp_ns=self.env.clock.now_ns())
