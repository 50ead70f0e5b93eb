"""`robrain foxglove`: a live team on the WebSocket that Foxglove and Lichtblick open."""

import asyncio
import json
import time
from typing import Any

import pytest
import websockets
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.model.geometry import Pose2D
from tests.system.conftest import endpoint_of
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system

PROTOCOL = "foxglove.sdk.v1"
MESSAGE = 1
HEADER_BYTES = 1 + 4 + 8
"""Opcode, subscription, log time."""


async def first_transforms(address: str) -> tuple[dict[str, dict[str, Any]], FrameTransforms]:
    """What is advertised, and the first message on the channel of transforms.

    The SDK advertises a channel a moment before it takes subscriptions to it. A twentieth of those that come at once
    are refused as "unknown channel", in a `status`, so a refused subscription is sent again.
    """
    channels: dict[str, dict[str, Any]] = {}
    wanted: list[dict[str, int]] = []
    async with websockets.connect(
        address, subprotocols=[websockets.Subprotocol(PROTOCOL)], open_timeout=PATIENCE_S, ping_interval=None
    ) as socket:
        while True:
            message = await asyncio.wait_for(socket.recv(), PATIENCE_S)
            if isinstance(message, str):
                told = json.loads(message)
                for channel in told.get("channels", []):
                    channels[channel["topic"]] = channel
                    if channel["topic"] == "/visual/tf":
                        wanted = [{"id": channel["id"], "channelId": channel["id"]}]
                if told["op"] in ("advertise", "status") and wanted:
                    await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            elif message[0] == MESSAGE:
                return channels, FrameTransforms.FromString(message[HEADER_BYTES:])


def test_a_live_team_is_served_to_foxglove(commands, hub, wire) -> None:
    states = wire.publisher(ROBOT_STATE, robot="r1")
    process = commands.start("foxglove", "--connect", endpoint_of(hub), "--port", "0")
    address = commands.line_with(process, "foxglove: ").split("foxglove: ", 1)[1].strip()
    assert address.startswith("ws://127.0.0.1:")

    async def speak_and_listen() -> tuple[dict[str, dict[str, Any]], FrameTransforms]:
        listening = asyncio.create_task(first_transforms(address))
        deadline_s = time.monotonic() + PATIENCE_S
        while not listening.done() and time.monotonic() < deadline_s:
            states.put(RobotState(robot="r1", pose=Pose2D(3.0, 4.0, 0.0), radius_m=0.2))
            await asyncio.sleep(0.05)
        return await listening

    channels, transforms = asyncio.run(speak_and_listen())
    [transform] = transforms.transforms
    assert (transform.parent_frame_id, transform.child_frame_id) == ("arena", "r1")
    assert (transform.translation.x, transform.translation.y) == (3.0, 4.0)
    assert channels["/visual/tf"]["schemaName"] == "foxglove.FrameTransforms"
    assert channels["/visual/tf"]["encoding"] == "protobuf"
