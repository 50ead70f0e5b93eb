"""Client of the action `NavigateToPose`, by which a robot's own Nav2 drives it to a pose.

An action is three services and two topics under its name (https://design.ros2.org/articles/actions.html).
"""

from collections.abc import Callable

import msgspec
import numpy as np

from robrain.protocol.ros2.definitions import (
    CancelRequest,
    CancelResponse,
    GoalAccepted,
    NavigateFeedback,
    NavigateGoal,
    NavigateResultResponse,
    NavigateSendGoal,
    ResultRequest,
)
from robrain.protocol.ros2.errors import NoReply
from robrain.protocol.ros2.message_classes import UUID, GoalInfo, PoseStamped, Time
from robrain.protocol.ros2.message_types import CANCEL_GOAL, NAVIGATE_FEEDBACK, NAVIGATE_GET_RESULT, NAVIGATE_SEND_GOAL
from robrain.protocol.ros2.qos import RELIABLE
from robrain.protocol.ros2.ros_node import RosNode
from robrain.protocol.ros2.ros_service import RosCall

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""Of `action_msgs/msg/GoalStatus`."""
ACCEPT_S = 5.0
RESULT_S = 86_400.0
"""How long the end of a drive is waited for."""
UUID_BYTES = 16


class Ended(msgspec.Struct, frozen=True):
    """How a drive ended."""

    status: int
    """One of `action_msgs/msg/GoalStatus`; 0 if the navigator sent none."""
    error_code: int = 0
    why: str = ""

    @property
    def is_there(self) -> bool:
        """Whether the robot has reached the pose."""
        return self.status == SUCCEEDED


class NavigateClient:
    """Sends one goal after another; a new one replaces the last. Nothing waits: `step` moves it on.

    Args:
        node: not closed by the client.
        name: of the action, relative to the node's namespace.
        new_id: 16 bytes that no other goal has.

    """

    def __init__(self, node: RosNode, new_id: Callable[[], bytes], name: str = "navigate_to_pose") -> None:
        self.feedback: NavigateFeedback | None = None
        """Last of the present goal."""
        self.is_accepted = False
        self.ended: Ended | None = None
        """Result of the last goal; None while one is in progress, and before the first."""
        self._new_id = new_id
        self._sends = node.client(f"{name}/_action/send_goal", NAVIGATE_SEND_GOAL)
        self._results = node.client(f"{name}/_action/get_result", NAVIGATE_GET_RESULT)
        self._cancels = node.client(f"{name}/_action/cancel_goal", CANCEL_GOAL)
        self._heard = node.subscribe(f"{name}/_action/feedback", NAVIGATE_FEEDBACK, RELIABLE)
        self._goal = b""
        self._sent: RosCall[GoalAccepted] | None = None
        self._result: RosCall[NavigateResultResponse] | None = None

    def go(self, pose: PoseStamped, behavior_tree: str = "") -> None:
        """Drive to a pose; the navigator preempts its work for an earlier goal."""
        self._goal = self._new_id()
        self.feedback, self.ended, self.is_accepted, self._result = None, None, False, None
        request = NavigateSendGoal(_uuid(self._goal), NavigateGoal(pose, behavior_tree))
        self._sent = self._sends.ask(request, ACCEPT_S)

    def cancel(self) -> RosCall[CancelResponse] | None:
        """Ask for the end of the present goal; None if there is none."""
        if not self._goal or self.ended is not None:
            return None
        return self._cancels.ask(CancelRequest(GoalInfo(_uuid(self._goal), Time(0, 0))), ACCEPT_S)

    def step(self) -> None:
        """Read the navigator's messages."""
        for heard in self._heard.take():
            if bytes(heard.message.goal_id.uuid) == self._goal:
                self.feedback = heard.message.feedback
        try:
            self._follow()
        except NoReply as error:
            self.ended, self._sent, self._result = Ended(0, why=str(error)), None, None

    def _follow(self) -> None:
        if self._sent is not None and (accepted := self._sent.poll()) is not None:
            self._sent = None
            if not accepted.accepted:
                self.ended = Ended(ABORTED, why="the navigator does not accept the goal")
                return
            self.is_accepted = True
            self._result = self._results.ask(ResultRequest(_uuid(self._goal)), RESULT_S)
        if self._result is not None and (end := self._result.poll()) is not None:
            self._result = None
            self.ended = Ended(end.status, end.result.error_code, end.result.error_msg)


def _uuid(goal: bytes) -> UUID:
    if len(goal) != UUID_BYTES:
        raise ValueError(f"expected a goal's id of {UUID_BYTES} bytes, got {len(goal)}")
    return UUID(np.frombuffer(goal, np.uint8))
