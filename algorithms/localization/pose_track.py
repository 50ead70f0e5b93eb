"""Recent poses with their times, and the pose at any time between them."""

from bisect import bisect_left
from collections import deque
from collections.abc import Iterable
from operator import itemgetter

from robrain.protocol.model.geometry import Pose2D, wrap_angle_rad


class PoseTrack:
    """The last poses of something that moves.

    Args:
        pose: before the first entry.
        entries_max: number of poses kept.
        entries: time (ns) and pose, the oldest first.

    """

    def __init__(self, pose: Pose2D, entries_max: int, entries: Iterable[tuple[int, Pose2D]] = ()) -> None:
        self.pose = pose
        """The newest one."""
        self._history: deque[tuple[int, Pose2D]] = deque(entries, entries_max)
        if self._history:
            self.pose = self._history[-1][1]

    @property
    def until_ns(self) -> int | None:
        """Time of the newest pose; None before the first."""
        return self._history[-1][0] if self._history else None

    def add(self, stamp_ns: int, pose: Pose2D) -> None:
        """Add the next pose; times do not descend."""
        self.pose = pose
        self._history.append((stamp_ns, pose))

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """The pose at a time, between the entries before and after it.

        Before the first entry kept it is that entry's pose, after `until_ns` the newest one.
        """
        history = self._history
        if not history or stamp_ns >= history[-1][0]:
            return self.pose
        index = bisect_left(history, stamp_ns, key=itemgetter(0))
        after_ns, after = history[index]
        if index == 0 or after_ns == stamp_ns:
            return after
        before_ns, before = history[index - 1]
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        return Pose2D(
            before.x_m + share * (after.x_m - before.x_m),
            before.y_m + share * (after.y_m - before.y_m),
            wrap_angle_rad(before.yaw_rad + share * wrap_angle_rad(after.yaw_rad - before.yaw_rad)),
        )
