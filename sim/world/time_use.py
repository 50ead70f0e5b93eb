"""The robots' use of time: driving, turning, waiting on the path, or standing without a task."""

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.ranges import Seconds

DRIVING_M_S = 0.05
"""Speed from which a robot drives (chosen: a twelfth of the stock driver's)."""
TURNING_RAD_S = 0.1
"""Turn rate from which a robot that does not drive turns (chosen)."""


class TimeUse(msgspec.Struct, frozen=True, kw_only=True):
    """Seconds that a robot spent; they add up to the run's length."""

    driving_s: Seconds = 0.0
    turning_s: Seconds = 0.0
    """On the spot."""
    waiting_s: Seconds = 0.0
    """Standing with a task: for other robots, for a path, or at work."""
    idle_s: Seconds = 0.0
    """Without a task."""


class TimeUseMeter:
    """Adds up the time use of all robots.

    Args:
        poses: (N, 3) true x, y in metres and yaw in radians (not wrapped) of each robot at the beginning.

    """

    def __init__(self, poses: NDArray[np.float64]) -> None:
        self._poses = poses
        self._spent_s = np.zeros((len(poses), 4))

    def add(self, poses: NDArray[np.float64], at_task: Sequence[bool], step_s: float) -> None:
        """Add the time since the last call.

        Args:
            poses: (N, 3) as above, now.
            at_task: whether each robot has a task.
            step_s: time since the last call, above 0.

        """
        rates = np.abs(poses - self._poses) / step_s
        self._poses = poses
        drives = rates[:, 0] ** 2 + rates[:, 1] ** 2 >= DRIVING_M_S**2
        still = np.where(np.asarray(at_task, dtype=np.bool_), 2, 3)
        what = np.where(drives, 0, np.where(rates[:, 2] >= TURNING_RAD_S, 1, still))
        self._spent_s[np.arange(len(poses)), what] += step_s

    def of(self, index: int) -> TimeUse:
        """The time use of a robot, by its number."""
        driving_s, turning_s, waiting_s, idle_s = self._spent_s[index].round(3).tolist()
        return TimeUse(driving_s=driving_s, turning_s=turning_s, waiting_s=waiting_s, idle_s=idle_s)
