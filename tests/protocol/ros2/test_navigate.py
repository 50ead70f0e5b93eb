"""NavigateToPose: the client against a navigator of the test, whose servers are robrain's own."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from robrain.protocol.ros2.definitions import (
    CancelResponse,
    GoalAccepted,
    NavigateFeedbackMessage,
    NavigateResult,
    NavigateResultResponse,
)
from robrain.protocol.ros2.message_classes import UUID, Time
from robrain.protocol.ros2.message_types import (
    CANCEL_GOAL,
    NAVIGATE_FEEDBACK,
    NAVIGATE_GET_RESULT,
    NAVIGATE_SEND_GOAL,
    POSE_STAMPED,
)
from robrain.protocol.ros2.navigate import ABORTED, CANCELED, SUCCEEDED, NavigateClient
from robrain.protocol.ros2.ros_node import RosNode
from robrain.protocol.wire.session import open_lockstep_session
from tests.waiting import until

ACTION = "/r1/navigate_to_pose/_action"


class Navigator:
    """The other side, step by step as the test says."""

    def __init__(self, node: RosNode) -> None:
        self.sends = node.serve(f"{ACTION}/send_goal", NAVIGATE_SEND_GOAL)
        self.results = node.serve(f"{ACTION}/get_result", NAVIGATE_GET_RESULT)
        self.cancels = node.serve(f"{ACTION}/cancel_goal", CANCEL_GOAL)
        self.feedback = node.advertise(f"{ACTION}/feedback", NAVIGATE_FEEDBACK)

    def accept(self, *, accepts: bool = True) -> Any:
        request = until(self.sends.requests)[0]
        request.reply(GoalAccepted(accepts, Time(0, 0)))
        return request.request


@pytest.fixture
def both() -> Iterator[tuple[NavigateClient, Navigator]]:
    ids = itertools.count(1)
    with open_lockstep_session() as session:
        node = RosNode(session, "robrain", namespace="/r1", now_ns=lambda: 0)
        other = RosNode(session, "bt_navigator", namespace="/r1", now_ns=lambda: 0)
        navigator = Navigator(other)
        yield NavigateClient(node, lambda: next(ids).to_bytes(16, "little")), navigator
        node.close()
        other.close()


def set_out(client: NavigateClient, navigator: Navigator) -> Any:
    """A goal that is accepted; returns the request for its result."""
    client.go(POSE_STAMPED.blank())
    navigator.accept()
    until(lambda: client.is_accepted, step=client.step)
    return until(navigator.results.requests, step=client.step)[0]


def result(status: int, code: int = 0, why: str = "") -> NavigateResultResponse:
    return NavigateResultResponse(status, NavigateResult(code, why))


def test_a_goal_is_accepted_followed_and_reached(both):
    client, navigator = both
    pose = POSE_STAMPED.blank()
    pose.header.frame_id, pose.pose.position.x = "map", 2.5
    client.go(pose)
    goal = navigator.accept()
    assert (goal.goal.pose.header.frame_id, goal.goal.pose.pose.position.x) == ("map", 2.5)
    until(lambda: client.is_accepted, step=client.step)
    asked = until(navigator.results.requests, step=client.step)[0]
    for number, left_m in ((1, 1.5), (9, 0.5)):  # the second is of another goal
        feedback = NAVIGATE_FEEDBACK.blank().feedback
        feedback.distance_remaining = left_m
        uuid = UUID(np.frombuffer(number.to_bytes(16, "little"), np.uint8))
        navigator.feedback.publish(NavigateFeedbackMessage(uuid, feedback))
    until(lambda: client.feedback is not None, step=client.step)
    client.step()
    assert client.feedback.distance_remaining == 1.5
    assert client.ended is None
    asked.reply(result(SUCCEEDED))
    until(lambda: client.ended is not None, step=client.step)
    assert client.ended.is_there


def test_a_goal_that_is_not_accepted_has_ended(both):
    client, navigator = both
    client.go(POSE_STAMPED.blank())
    navigator.accept(accepts=False)
    until(lambda: client.ended is not None, step=client.step)
    assert (client.ended.status, client.is_accepted, client.cancel()) == (ABORTED, False, None)


def test_a_failure_has_the_navigators_code_and_words(both):
    client, navigator = both
    set_out(client, navigator).reply(result(ABORTED, 9002, "no transform"))
    until(lambda: client.ended is not None, step=client.step)
    assert (client.ended.is_there, client.ended.error_code, client.ended.why) == (False, 9002, "no transform")


def test_a_goal_is_cancelled_by_its_id(both):
    client, navigator = both
    asked = set_out(client, navigator)
    call = client.cancel()
    request = until(navigator.cancels.requests)[0]
    assert bytes(request.request.goal_info.goal_id.uuid) == (1).to_bytes(16, "little")
    request.reply(CancelResponse(0, [request.request.goal_info]))
    assert call.wait().return_code == 0
    asked.reply(result(CANCELED))
    until(lambda: client.ended is not None, step=client.step)
    assert (client.ended.status, client.ended.is_there) == (CANCELED, False)


def test_a_new_goal_takes_the_place_of_the_last(both):
    client, navigator = both
    before = set_out(client, navigator)
    now = set_out(client, navigator)
    before.reply(result(ABORTED))
    client.step()
    assert client.ended is None
    now.reply(result(SUCCEEDED))
    until(lambda: client.ended is not None, step=client.step)
    assert client.ended.is_there


def test_the_end_of_the_last_goal_is_not_that_of_one_just_sent(both):
    client, navigator = both
    before = set_out(client, navigator)
    client.go(POSE_STAMPED.blank())
    before.reply(result(ABORTED))
    client.step()
    assert client.ended is None
    navigator.accept()
    until(lambda: client.is_accepted, step=client.step)
    assert client.ended is None


def test_without_a_navigator_a_goal_ends_with_the_reason():
    with open_lockstep_session() as session:
        node = RosNode(session, "robrain", now_ns=lambda: 0)
        client = NavigateClient(node, lambda: bytes(16))
        client.go(POSE_STAMPED.blank())
        until(lambda: client.ended is not None, step=client.step)
        assert "/navigate_to_pose/_action/send_goal: no server" in client.ended.why
        node.close()
