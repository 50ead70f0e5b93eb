"""Exchange of submaps and loop closures between the mappers of a team."""

import logging
from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.slam.map_patch import (
    AHEAD_MAX_MS,
    SharedSteps,
    in_own_time,
    joined_message,
    map_stamp_ms,
    merge_message,
    pose_message,
    to_message,
    whole_map,
)
from robrain.algorithms.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.algorithms.slam.submap_graph import OwnSubmap
from robrain.plugins.skill.mapper.closures import ClosureFinder
from robrain.plugins.skill.mapper.frames import Frames
from robrain.plugins.skill.mapper.own_submaps import OwnPatch, OwnSubmaps
from robrain.protocol.border.border import Received
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import AHEAD_S, BEHIND_S, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import (
    FLOOR,
    ROBOT_CLOSURES,
    ROBOT_MAP,
    ROBOT_MAP_WHOLE,
    Closures,
    MapPatch,
)
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.model.geometry import IDENTITY
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.refusals import RefusalCode
from robrain.protocol.wire.endpoint import Endpoint

logger = logging.getLogger(__name__)

WHOLE_MS = 400
"""Milliseconds after the start in which the whole maps of the others may have been seen; below `PUBLISH_AFTER_S`."""
INBOX_MAX = 4096
"""Messages that wait; the oldest are dropped and counted."""


class MapReceiver:
    """Receives the maps and closures of the other robots.

    Args:
        robot: that listens.
        atlas: takes the submaps.
        desk: takes the closures.
        frames: follows teammates into better frames.

    """

    def __init__(self, robot: str, atlas: SubmapAtlas, desk: ClosureFinder, frames: Frames) -> None:
        self.others: SubmapAtlas | None = None
        """Submaps that the others had before this robot started; only while its start is checked."""
        self.withdrawn: set[int] = set()
        """Numbers of this robot's submaps that it has withdrawn."""
        self._robot = robot
        self._atlas = atlas
        self._shared = SharedSteps(atlas)
        self._desk = desk
        self._frames = frames
        self._inbox = Inbox(capacity=INBOX_MAX)
        self._refused: set[str] = set()
        self._met = {FLOOR}
        """Robots whose liveliness token has been seen, and the known floor."""
        self._orphans: set[SubmapKey] = set()
        """Submaps of robots that have gone since."""
        self._began_ms = 0
        self._allowed_ms = 0
        """Latest time of observation that is not from the future, at this step."""

    @property
    def dropped(self) -> int:
        """Messages that came faster than they were merged."""
        return self._inbox.dropped

    def begin(self, began_ns: int) -> None:
        """Record the robot's start, at this time of its clock."""
        self._began_ms = map_stamp_ms(began_ns)
        self.others = SubmapAtlas(self._atlas.grid.geometry)

    def connect(self, wire: Endpoint) -> None:
        """Subscribe from now on."""
        self._wire = wire
        self._guard = RecordGuard(wire.refusals)
        self._presence = wire.watch(ROBOT_ALIVE)
        wire.subscribe(self._inbox, ROBOT_MAP)
        wire.subscribe(self._inbox, ROBOT_CLOSURES)

    def step(self) -> None:
        """Take the received messages into the map."""
        for change in self._presence.changes():
            name = change.names["robot"]
            self._met.add(name)
            if not change.present:
                # If the robot restarts, it does not know these submaps, so this robot keeps publishing them.
                self._orphans.update(key for key in self._atlas.submaps if key[0] == name)
            if change.present and name != self._robot:
                # Catch up with a robot that was there before; one that has just started has nothing to publish.
                self._wire.ask_into(self._inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=name)
        self._allowed_ms = map_stamp_ms(self._wire.clock.now_ns()) + AHEAD_MAX_MS
        self._merge_all(self._inbox.drain())

    def whole(self) -> MapPatch | None:
        """The robot's submaps, the known floor, and submaps of absent or restarted robots, with the current time."""
        others = self._met - {self._robot, FLOOR}
        keys = [key for key in sorted(self._atlas.submaps) if key[0] not in others or key in self._orphans]
        message = whole_map(self._robot, self._atlas, keys)
        return message and msgspec.structs.replace(message, stamp_ns=self._wire.clock.now_ns())

    def _merge_all(self, received: Sequence[Received]) -> None:
        """Merge messages, one after the other; successive patches of which only cells are new are drawn at once."""
        arrived = self._met - {self._robot}
        now_ns = self._wire.clock.now_ns()
        earliest_ns, latest_ns = now_ns - to_ns(BEHIND_S), now_ns + to_ns(AHEAD_S)
        for one in received:
            message = one.message
            is_patch = one.topic is ROBOT_MAP and not message.parts and message.observed_ms <= self._allowed_ms
            is_patch = is_patch and earliest_ns <= message.stamp_ns <= latest_ns
            has_variances = is_patch and (message.variance_m2 > 0.0 or message.variance_rad2 > 0.0)
            if is_patch and not has_variances and message.robot in arrived and self._shared.add(message):
                continue
            self._shared.flush()
            self._guard.messages((one,), self._handle)
        self._shared.flush()

    def _handle(self, received: Received) -> None:
        message: MapPatch | Closures = received.message
        if message.robot == self._robot:
            return
        refusals = self._wire.refusals
        if message.robot not in self._met:
            # nothing is lost: the mapper asks for its whole map when its token appears
            reason = f"{message.robot} is not there"
            refusals.record(received.topic.name, received.key, RefusalCode.UNKNOWN_SENDER, reason)
            return
        reason = self._desk.receive(message) if isinstance(message, Closures) else self._merge(message)
        if reason:
            refusals.record(received.topic.name, received.key, RefusalCode.NOT_PLAUSIBLE, reason)

    def _merge(self, patch: MapPatch) -> str:
        """Merge a patch into the map; returns the reason for a refusal, empty if there is none."""
        try:
            patch = in_own_time(patch, self._wire.clock.now_ns())
            if patch.parts:
                patch = self._without_own(patch)
            move = self._frames.move_of(patch)
            merge_message(self._atlas, patch)
            if self.others is not None:
                before = tuple(part for part in patch.parts if self._was_before(part))
                merge_message(self.others, msgspec.structs.replace(patch, parts=before, rows=0, columns=0, cells=b""))
        except ValueError as error:
            if patch.robot not in self._refused:
                self._refused.add(patch.robot)
                logger.warning("%s: the map of %s cannot be merged: %s", self._robot, patch.robot, error)
            return str(error)
        # It still knows them: it was out of reach, not restarted.
        self._orphans.difference_update((patch.robot, part.submap) for part in patch.parts if part.robot == patch.robot)
        self._desk.receive_submap_poses(patch)
        if move is not None:
            self._frames.follow(move)
        return ""

    def _without_own(self, patch: MapPatch) -> MapPatch:
        """A patch without the submaps that this robot has made itself since it started.

        Others publish them while they do not receive this robot, and may not know that some are withdrawn.

        Raises:
            ValueError: it has one that this robot has not made.

        """
        own = [part.submap for part in patch.parts if part.robot == self._robot and part.submap >= self._began_ms]
        if not own:
            return patch
        if any((self._robot, number) not in self._atlas.submaps and number not in self.withdrawn for number in own):
            raise ValueError(f"{patch.robot} tells a submap of {self._robot} that {self._robot} has not made")
        parts = tuple(part for part in patch.parts if part.robot != self._robot or part.submap < self._began_ms)
        return msgspec.structs.replace(patch, parts=parts)

    def _was_before(self, part: MapPatch) -> bool:
        """Whether a submap was begun before this robot started, and its cells were seen at most `WHOLE_MS` after it.

        The known floor always was.
        """
        return part.robot == FLOOR or (part.submap < self._began_ms and part.observed_ms <= self._began_ms + WHOLE_MS)


class MapSender:
    """Collects messages about one robot's submaps until they are sent.

    Args:
        robot: whose submaps they are.
        geometry: the team's grid.

    """

    def __init__(self, robot: str, geometry: GridGeometry) -> None:
        self._robot = robot
        self._geometry = geometry
        self._untold: list[MapPatch] = []

    def patch(self, patch: OwnPatch, own: OwnSubmaps) -> None:
        """Cells of the submap that is being made have changed."""
        place, frame = own.T_arena_local, own.frame
        self._untold.append(to_message(self._robot, self._geometry, patch.cells, patch.submap, place, frame))

    def finished(self, number: int, own: OwnSubmaps, surfaces: NDArray[np.void]) -> None:
        """A submap is finished."""
        place, frame, variances = own.T_arena_local, own.frame, _variances(own.graph.own[number])
        message = pose_message(
            self._robot, self._geometry, number, place, frame, surfaces=surfaces, variances=variances
        )
        self._untold.append(message)

    def placed(self, nodes: list[OwnSubmap]) -> None:
        """Submaps of the pose graph have moved."""
        reported = []
        for node in nodes:
            place, frame = node.T_arena_local, node.frame
            reported.append(
                pose_message(self._robot, self._geometry, node.number, place, frame, variances=_variances(node))
            )
        self.moved(reported)

    def moved(self, messages: list[MapPatch]) -> None:
        """Submaps have moved, by these messages."""
        if messages:
            self._untold.append(joined_message(self._robot, self._geometry, messages))

    def withdrawn(self, numbers: list[int]) -> None:
        """Forget withdrawn submaps.

        Their unsent parts are dropped.
        """
        self._untold = [each for each in self._untold if each.submap not in numbers or each.parts]
        self.moved([pose_message(self._robot, self._geometry, each, IDENTITY, withdrawn=True) for each in numbers])

    def drain(self) -> list[MapPatch]:
        """Return the queued messages in order, and empty the queue."""
        untold, self._untold = self._untold, []
        return untold


def _variances(node: OwnSubmap) -> tuple[float, float]:
    return max(float(node.covariance[0, 0]), float(node.covariance[1, 1])), float(node.covariance[2, 2])
