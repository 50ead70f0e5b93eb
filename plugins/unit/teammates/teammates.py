"""Teammates: where the other robots are, where they go and whether they still move, by what they publish."""

import math

import msgspec
import numpy as np

from robrain.agent.plugin import Unit, external
from robrain.plugins.unit.teammates.interface import Doing, Mate, Teammate, TeammatesInterface
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.mapping.map_frame import ARENA, MapFrame
from robrain.protocol.model.navigation.claim import Claim
from robrain.protocol.model.navigation.right_of_way import MATE_AHEAD_M, STEP_M, Track, Way
from robrain.protocol.model.numeric.kernel_array import Floats
from robrain.protocol.model.ranges import check_positive
from robrain.protocol.wire.border.border import Received
from robrain.protocol.wire.border.record_guard import RecordGuard
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.robot_messages import PlannedPath, RobotState
from robrain.protocol.wire.topics import ROBOT_PATH, ROBOT_STATE

HEAR_NS = to_ns(0.15)
"""Each mate sends ten states a second; every second one is enough, and decoding dominates the cost."""
MATES_MAX = 4096
"""Largest number of robots that are tracked."""

MOVED_M = 0.1
"""Less than this is no motion."""
AT_END = 3
"""Positions left of a way that is as good as driven: 0.2 m, as near as drivers get."""
ROLLS_M_S = 0.1
ROLLS_S = 1.5
"""Who moves faster than that without a path is taken to go straight on for so long."""
LEAST_W = 0.1
LOST_MARGIN_M = 0.5
"""Kept from a mate that does not know where it is, beyond its radius; chosen."""


class KnownMate:
    """Follows the states and paths of one other robot.

    Args:
        name: its name.
        stalled_ns: who is under way, waits for nobody and has not moved for so long is an obstacle.
        speed_m_s: taken for a mate that does not say how fast it goes.

    """

    def __init__(self, name: str, stalled_ns: int, speed_m_s: float) -> None:
        self.name = name
        self.heard_ns = 0
        """When its state was heard last."""
        self.spoke_ns = 0
        """When anything was."""
        self.teammate: Teammate | None = None
        """None before it has told where it is."""
        self.frame = ARENA
        """The map frame in which it tells that."""
        self._stalled_ns = stalled_ns
        self._default_speed_m_s = speed_m_s
        self._moved_ns = 0
        self._moved_at: Pose2D | None = None
        self._is_halted = self._is_lost = False
        self._task = self._behavior = ""
        self._endurance_s = math.inf
        self._way: Way | None = None
        self._claim = Claim()
        self._speed_m_s = speed_m_s
        self._held_at_m: float | None = None
        self._mate: Mate | None = None
        self._made_ns = -1

    def hear_state(self, state: RobotState, now_ns: int) -> None:
        """Take its state."""
        self.spoke_ns = now_ns
        pose = state.pose
        if pose is None:
            return
        self.heard_ns = now_ns
        self.teammate = Teammate(self.name, pose, state.velocity, state.radius_m)
        self.frame = state.frame
        self._is_halted, self._is_lost = state.halted, bool(state.lost)
        self._behavior = state.behavior
        energy = state.energy
        if energy is not None:
            self._endurance_s = energy.usable_j / max(energy.usual_power_w, LEAST_W)
        self._task = state.task.id if state.task is not None and not state.task.state.ended else ""
        if self._moved_at is None or pose.distance_m(self._moved_at) > MOVED_M:
            self._moved_at = pose
            self._moved_ns = now_ns

    def hear_path(self, path: PlannedPath, now_ns: int) -> None:
        """Take its path."""
        self.spoke_ns = now_ns
        has_stood = not self._has_way_left()
        self._way = Way(np.array([(point.x_m, point.y_m) for point in path.points])) if path.points else None
        self._claim = path.claim
        self._speed_m_s = path.speed_m_s if path.speed_m_s > 0 else self._default_speed_m_s
        if self._held_at_m is not None or has_stood:
            self._moved_ns = now_ns  # it has been waiting or standing, and only now may be expected to move
        self._held_at_m = path.held_at_m
        self._made_ns = -1

    def _has_way_left(self) -> bool:
        known, way = self.teammate, self._way
        return (
            known is not None
            and way is not None
            and len(way.ahead(known.pose.x_m, known.pose.y_m, MATE_AHEAD_M)) > AT_END
        )

    def mate(self, now_ns: int, fresh_ns: int) -> Mate | None:
        """As it is to be reckoned with; None before it has told where it is."""
        known = self.teammate
        if known is None:
            return None
        is_fresh = now_ns - self.heard_ns <= fresh_ns
        if self._mate is None or self._made_ns != self.heard_ns or not is_fresh:
            self._made_ns = self.heard_ns
            self._mate = self._reckon(known, now_ns, is_fresh=is_fresh)
        return self._mate

    def _reckon(self, known: Teammate, now_ns: int, *, is_fresh: bool) -> Mate:
        place = (known.pose.x_m, known.pose.y_m)
        positions = np.array([place]) if self._way is None else self._way.ahead(*place, MATE_AHEAD_M)
        doing = self._doing(positions.shape[0], now_ns, is_fresh=is_fresh)
        speed_m_s, radius_m = self._speed_m_s, known.radius_m + LOST_MARGIN_M * self._is_lost
        if doing is not Doing.UNDER_WAY:
            speed_m_s = math.hypot(known.velocity.forward_m_s, known.velocity.left_m_s)
            positions = _rolling_on(known, speed_m_s if is_fresh else 0.0)
        held_at = positions.shape[0] - 1
        if doing is Doing.UNDER_WAY and self._held_at_m is not None and self._way is not None:
            held_at = max(0, min(held_at, round((self._held_at_m - self._way.passed_m) / STEP_M)))
        track = Track(positions, speed_m_s, held_at, radius_m, goes_first=False)
        bound = Point2D(*place) if self._way is None or doing is not Doing.UNDER_WAY else self._way.end
        return Mate(
            self.name,
            known.pose,
            radius_m,
            doing,
            self._claim,
            track,
            self._task,
            bound,
            self._behavior,
            self._endurance_s,
        )

    def _doing(self, positions: int, now_ns: int, *, is_fresh: bool) -> Doing:
        if not is_fresh or self._is_halted or self._is_lost:
            return Doing.OBSTACLE
        if positions <= AT_END:
            return Doing.STANDING
        if self._held_at_m is None and now_ns - self._moved_ns > self._stalled_ns:
            return Doing.OBSTACLE
        return Doing.UNDER_WAY


def _rolling_on(mate: Teammate, speed_m_s: float) -> Floats:
    """Where a mate will be that has no path: where it is and, while it moves, straight on."""
    pose = mate.pose
    steps = math.ceil(speed_m_s * ROLLS_S / STEP_M) if speed_m_s > ROLLS_M_S else 0
    heading_rad = pose.yaw_rad + math.atan2(mate.velocity.left_m_s, mate.velocity.forward_m_s)
    along_m = STEP_M * np.arange(steps + 1)
    return np.stack((pose.x_m + along_m * math.cos(heading_rad), pose.y_m + along_m * math.sin(heading_rad)), axis=1)


def is_near(mate: Mate, place: Point2D, within_m: float) -> bool:
    """Whether a mate is, or is bound, within a distance of a place."""
    if mate.pose.distance_m(place) <= within_m:
        return True
    apart = mate.track.positions - (place.x_m, place.y_m)
    return bool(np.min(apart[:, 0] ** 2 + apart[:, 1] ** 2) <= within_m**2)


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
            check_positive(self)

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
