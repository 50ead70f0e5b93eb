"""What one robot knows of one other: where it is, where it goes, whether it still moves."""

import math

import numpy as np

from robrain.plugins.unit.teammates.interface import Doing, Mate, Teammate
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.mapping.map_frame import ARENA
from robrain.protocol.model.navigation.claim import Claim
from robrain.protocol.model.navigation.right_of_way import MATE_AHEAD_M, STEP_M, Track, Way
from robrain.protocol.model.numeric.kernel_array import Floats
from robrain.protocol.wire.messages.robot_messages import PlannedPath, RobotState

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
