"""What one robot knows of one other: where it is, where it goes, whether it still moves."""

import numpy as np

from robrain.plugins.unit.teammates.interface import Doing, Mate, Teammate
from robrain.protocol.model.claim import Claim
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.right_of_way import MATE_AHEAD_M, STEP_M, Track, Way
from robrain.protocol.wire.messages import PlannedPath, RobotState

MOVED_M = 0.1
"""Less than this is no motion."""
AT_END = 3
"""Positions left of a way that is as good as driven: 0.2 m, as near as drivers get."""


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
        self._stalled_ns = stalled_ns
        self._default_speed_m_s = speed_m_s
        self._moved_ns = 0
        self._moved_at: Pose2D | None = None
        self._is_halted = False
        self._task = ""
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
        self._is_halted = state.halted
        self._task = state.task.id if state.task is not None and not state.task.state.ended else ""
        if self._moved_at is None or pose.distance_m(self._moved_at) > MOVED_M:
            self._moved_at = pose
            self._moved_ns = now_ns

    def hear_path(self, path: PlannedPath, now_ns: int) -> None:
        """Take its path."""
        self.spoke_ns = now_ns
        self._way = Way(np.array([(point.x_m, point.y_m) for point in path.points])) if path.points else None
        self._claim = path.claim
        self._speed_m_s = path.speed_m_s if path.speed_m_s > 0 else self._default_speed_m_s
        if path.held_at_m is not None or self._held_at_m is not None:
            self._moved_ns = now_ns  # it has been waiting, and only now may be expected to move
        self._held_at_m = path.held_at_m
        self._made_ns = -1

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
        if doing is not Doing.UNDER_WAY:
            positions = positions[:1]
        held_at = positions.shape[0] - 1
        if self._held_at_m is not None and self._way is not None:
            held_at = max(0, min(held_at, round((self._held_at_m - self._way.passed_m) / STEP_M)))
        track = Track(positions, self._speed_m_s, held_at, known.radius_m, goes_first=False)
        return Mate(self.name, known.pose, known.radius_m, doing, self._claim, track, self._task)

    def _doing(self, positions: int, now_ns: int, *, is_fresh: bool) -> Doing:
        if not is_fresh or self._is_halted:
            return Doing.OBSTACLE
        if positions <= AT_END:
            return Doing.STANDING
        if self._held_at_m is None and now_ns - self._moved_ns > self._stalled_ns:
            return Doing.OBSTACLE
        return Doing.UNDER_WAY


def is_near(mate: Mate, place: Point2D, within_m: float) -> bool:
    """Whether a mate is, or is bound, within a distance of a place."""
    if mate.pose.distance_m(place) <= within_m:
        return True
    apart = mate.track.positions - (place.x_m, place.y_m)
    return bool(np.min(apart[:, 0] ** 2 + apart[:, 1] ** 2) <= within_m**2)
