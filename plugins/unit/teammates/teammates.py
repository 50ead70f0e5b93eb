"""Teammates: follows the states and paths that the other robots publish."""

import msgspec

from robrain.agent.plugin import Unit, external
from robrain.plugins.unit.teammates.interface import Mate, Teammate, TeammatesInterface
from robrain.plugins.unit.teammates.known_mate import KnownMate, is_near
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.mapping.map_frame import MapFrame
from robrain.protocol.wire.border.border import Received
from robrain.protocol.wire.border.record_guard import RecordGuard
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import ROBOT_PATH, ROBOT_STATE

HEAR_NS = to_ns(0.15)
"""Each mate sends ten states a second; every second one is enough, and decoding dominates the cost."""
MATES_MAX = 4096
"""Largest number of robots that are tracked."""


class Teammates(Unit):
    """Tracks places and paths of the other robots."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """When a mate counts as lost, and for how long. All are chosen."""

        fresh_s: float = 2.0
        """Time of silence after which a robot is lost: an obstacle at its last place."""
        remember_s: float = 60.0
        """Time after which a lost robot is forgotten; by then the lidar has mapped it if it is still there."""
        stalled_s: float = 4.0
        """Time without motion after which a driving robot that waits for no other is an obstacle as well."""
        speed_m_s: float = 0.6
        """Speed assumed for a robot that does not publish one."""

        def __post_init__(self) -> None:
            for name in self.__struct_fields__:
                if not getattr(self, name) > 0:
                    raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")

    interface = TeammatesInterface
    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self._inbox = Inbox()
        self._next_ns = 0
        self._known: dict[str, KnownMate] = {}
        self._fresh_ns = to_ns(self.parameters.fresh_s)

    def activate(self) -> None:
        self._guard = RecordGuard(self.env.wire.refusals)
        self.env.wire.subscribe(self._inbox, ROBOT_STATE)
        self.env.wire.subscribe(self._inbox, ROBOT_PATH)

    def step(self) -> None:
        self._hear()

    @external
    def others(self) -> list[Teammate]:
        """Those heard within the last two seconds, by name, in the robot's map frame."""
        return self.in_frame(self.env.board.frame)

    def in_frame(self, frame: MapFrame) -> list[Teammate]:
        """Those heard within the last two seconds that tell their poses in a map frame, by name."""
        now_ns = self._hear()
        return [
            known.teammate
            for known in self._known.values()
            if known.teammate is not None and known.frame == frame and now_ns - known.heard_ns <= self._fresh_ns
        ]

    def count(self) -> int:
        """How many were heard within the last two seconds, in whichever map frame."""
        now_ns = self._hear()
        return sum(now_ns - known.heard_ns <= self._fresh_ns for known in self._known.values())

    def mates(self, place: Point2D, within_m: float) -> list[Mate]:
        """Those that are, or are bound, within a distance of a place, by name; also those that have fallen silent."""
        now_ns = self._hear()
        frame = self.env.board.frame
        mates = [known.mate(now_ns, self._fresh_ns) for known in self._known.values() if known.frame == frame]
        return [mate for mate in mates if mate is not None and is_near(mate, place, within_m)]

    def _hear(self) -> int:
        now_ns = self.env.clock.now_ns()
        if now_ns < self._next_ns or not len(self._inbox):
            return now_ns
        self._next_ns = now_ns + HEAR_NS
        count = len(self._known)
        self._guard.messages(self._inbox.drain(), self._take)
        too_old_ns = now_ns - to_ns(self.parameters.remember_s)
        if len(self._known) != count or any(known.spoke_ns < too_old_ns for known in self._known.values()):
            by_name = sorted(self._known.items())
            self._known = {name: known for name, known in by_name if known.spoke_ns >= too_old_ns}
        return now_ns

    def _take(self, received: Received) -> None:
        message, now_ns = received.message, self.env.clock.now_ns()
        if message.robot == self.env.robot:
            return
        known = self._known.get(message.robot)
        if known is None:
            if len(self._known) >= MATES_MAX:
                return
            stalled_ns = to_ns(self.parameters.stalled_s)
            known = self._known[message.robot] = KnownMate(message.robot, stalled_ns, self.parameters.speed_m_s)
        if received.topic is ROBOT_STATE:
            known.hear_state(message, now_ns)
        else:
            known.hear_path(message, now_ns)
