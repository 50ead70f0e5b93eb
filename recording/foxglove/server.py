"""Channels of a live team for Foxglove, served on a WebSocket by Foxglove's own SDK; no log-in, so loopback only."""

import foxglove

from robrain.protocol.clock import to_ns
from robrain.protocol.errors import WireError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.topic import Topic
from robrain.protocol.wire.endpoint import Endpoint
from robrain.recording.foxglove.channels import DRAWN, FoxgloveChannels, VisualMessage

AGAIN_NS = to_ns(5.0)
"""Period at which all channels are published again, for viewers that have come meanwhile."""
INBOX_CAPACITY = 16384


class FoxgloveServer:
    """Serves the visual channels of a team.

    Args:
        wire: endpoint of the team; its owner closes it, after the server.
        host: address to listen on.
        port: 0 uses a free one.

    Raises:
        WireError: the port cannot be listened on.
    """

    def __init__(self, wire: Endpoint, host: str, port: int) -> None:
        self._wire = wire
        self._clock = wire.clock
        self._inbox = Inbox(INBOX_CAPACITY, every=True)
        self._visual = FoxgloveChannels()
        self._context = foxglove.Context()
        self._channels: dict[str, foxglove.Channel] = {}
        self._again_ns = self._clock.now_ns() + AGAIN_NS
        self._asked: set[str] = set()
        try:
            self._server = foxglove.start_server(name="robrain", host=host, port=port, context=self._context)
        except (RuntimeError, OSError) as error:
            raise WireError(
                f"cannot listen on {host}:{port}: {error}; give another port, or 0 for a free one"
            ) from error
        self.address = f"ws://{host}:{self._server.port}"
        for topic in DRAWN:
            wire.subscribe(self._inbox, topic)

    def step(self) -> None:
        """Serve all messages that are due."""
        now_ns = self._clock.now_ns()
        for topic, key, payload in self._inbox.drain_raw():
            if isinstance(topic, Topic):
                self._visual.handle(topic, key, payload)
            if topic is ROBOT_STATE:
                self._ask_map(key)
        if now_ns >= self._again_ns:
            self._again_ns = now_ns + AGAIN_NS
            self._visual.restart()
        for message in self._visual.due(now_ns):
            self._channel(message).log(message.data(), log_time=message.stamp_ns)

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()

    def _ask_map(self, key: str) -> None:
        """Patches have changes only: a new robot is asked for its whole map."""
        if key not in self._asked:
            self._asked.add(key)
            names = ROBOT_STATE.parse(key) or {}
            self._wire.ask_into(self._inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=names["robot"])

    def _channel(self, message: VisualMessage) -> foxglove.Channel:
        channel = self._channels.get(message.channel)
        if channel is None:
            name, encoding, data = message.schema()
            channel = self._channels[message.channel] = foxglove.Channel(
                message.channel,
                schema=foxglove.Schema(name=name, encoding=encoding, data=data),
                message_encoding=message.encoding,
                context=self._context,
            )
        return channel
