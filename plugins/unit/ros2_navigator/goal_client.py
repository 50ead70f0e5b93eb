"""Goals for Nav2: one at a time, sent and cancelled on the thread of the ROS node, with their ends in an inbox."""

import math
import threading
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from functools import partial
from typing import Any, NamedTuple

from rclpy.action import ActionClient

from robrain.agent.errors import HardwareAbsent
from robrain.plugins.device.ros2.link import Ros2Link
from robrain.protocol.model.geometry import Pose2D

ENDS_MAX = 64
CANCEL_S = 0.5
"""How long the end of the client waits until Nav2 has taken the cancellation."""
SUCCEEDED, CANCELED = 4, 5
"""Of action_msgs/GoalStatus."""


class GoalState(StrEnum):
    """How a goal ended."""

    ARRIVED = "arrived"
    FAILED = "failed"
    CANCELLED = "cancelled"


class GoalEnd(NamedTuple):
    """The end of a goal."""

    number: int
    state: GoalState
    why: str = ""


class GoalClient:
    """A client of the action NavigateToPose.

    Args:
        plugin: whose it is, for errors.
        link: the node.
        topic: name of the action.
        on_end: called on the thread of the node after a goal has ended.

    Raises:
        HardwareAbsent: Nav2's interfaces are not installed.

    """

    def __init__(self, plugin: str, link: Ros2Link, topic: str, on_end: Callable[[], None]) -> None:
        try:
            from nav2_msgs.action import NavigateToPose
        except ModuleNotFoundError as error:
            what = "nav2_msgs is not installed: it comes with Nav2, as in ros-jazzy-nav2-msgs"
            raise HardwareAbsent(plugin, what) from error
        self._kind: Any = NavigateToPose
        self._link, self._topic, self._on_end = link, topic, on_end
        self._client: Any = link.do(lambda: ActionClient(link.node, NavigateToPose, topic))
        self._ends: deque[GoalEnd] = deque(maxlen=ENDS_MAX)
        self._handles: dict[int, Any] = {}
        """Of the goals that Nav2 has accepted and not ended; on the thread of the node."""
        self._last = 0
        self._cancelled_to = 0
        """Goals up to this number are to be cancelled."""
        self._is_idle = threading.Event()
        self._is_idle.set()

    def send(self, number: int, pose: Pose2D, frame: str, stamp: tuple[int, int]) -> None:
        """Send a goal in place of those before; its end comes in `drain`.

        Args:
            number: greater than those before.
            pose: in `frame`.
            frame: name of the ROS frame.
            stamp: seconds and nanoseconds.

        """
        goal = self._kind.Goal()
        goal.pose.header.frame_id = frame
        goal.pose.header.stamp.sec, goal.pose.header.stamp.nanosec = stamp
        goal.pose.pose.position.x, goal.pose.pose.position.y = pose.x_m, pose.y_m
        goal.pose.pose.orientation.z, goal.pose.pose.orientation.w = (
            math.sin(pose.yaw_rad / 2),
            math.cos(pose.yaw_rad / 2),
        )
        self._last = number
        self._is_idle.clear()
        self._link.later(lambda: self._send(number, goal))

    def cancel(self) -> None:
        """Cancel all goals that were sent; returns at once, on any thread."""
        self._cancelled_to = self._last
        self._link.later(self._cancel)

    def drain(self) -> list[GoalEnd]:
        """The ends of goals since the last call."""
        return [self._ends.popleft() for _ in range(len(self._ends))]

    def close(self) -> None:
        """Cancel all goals, and end; waits a moment until Nav2 has taken that."""
        self.cancel()
        self._is_idle.wait(CANCEL_S)
        self._link.end(self._client.destroy)

    def _send(self, number: int, goal: Any) -> None:
        if number <= self._cancelled_to:
            self._end(GoalEnd(number, GoalState.CANCELLED))
        elif not self._client.server_is_ready():
            self._end(GoalEnd(number, GoalState.FAILED, f"there is no action server {self._topic}"))
        else:
            self._client.send_goal_async(goal).add_done_callback(partial(self._answered, number))

    def _answered(self, number: int, answer: Any) -> None:
        handle = answer.result()
        if handle is None or not handle.accepted:
            self._end(GoalEnd(number, GoalState.FAILED, "Nav2 has rejected the goal"))
            return
        self._handles[number] = handle
        handle.get_result_async().add_done_callback(partial(self._ended, number))
        if number <= self._cancelled_to:
            handle.cancel_goal_async()

    def _cancel(self) -> None:
        for number, handle in self._handles.items():
            if number <= self._cancelled_to:
                handle.cancel_goal_async()

    def _ended(self, number: int, answer: Any) -> None:
        self._handles.pop(number, None)
        found = answer.result()
        if found.status == SUCCEEDED:
            self._end(GoalEnd(number, GoalState.ARRIVED))
        elif found.status == CANCELED:
            self._end(GoalEnd(number, GoalState.CANCELLED, "Nav2's goal was cancelled"))
        else:
            code, words = getattr(found.result, "error_code", 0), getattr(found.result, "error_msg", "")
            self._end(GoalEnd(number, GoalState.FAILED, f"Nav2 does not get there: {words or f'error {code}'}"))

    def _end(self, end: GoalEnd) -> None:
        self._ends.append(end)
        if end.number == self._last:
            self._is_idle.set()
        self._on_end()
