"""Who can do what: the plugins of each robot, as their hosts tell them."""

import msgspec

from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages import PluginInfo
from robrain.protocol.wire.topics import ROBOT_PLUGINS

ASK_AGAIN_NS = to_ns(10.0)
"""Plugins are loaded and unloaded while a robot runs (chosen)."""
ASK_UNHEARD_NS = to_ns(1.0)


class Capabilities:
    """Asks each robot for its plugins when it comes and now and then, without waiting for the answers.

    Args:
        wire: the coordinator's place on the wire.

    """

    def __init__(self, wire: Endpoint) -> None:
        self.plugins: dict[str, frozenset[str] | None] = {}
        """Of each robot that ever came; None as long as it has not told them."""
        self._wire = wire
        self._inbox = Inbox()
        self._asked_ns: dict[str, int] = {}
        self._decoder = msgspec.json.Decoder(list[PluginInfo])

    def follow(self, robots: list[str], now_ns: int) -> bool:
        """Take in what was answered, and ask these robots, which are there, if it is time; True if there is news."""
        before = dict(self.plugins)
        for robot in robots:
            known = self.plugins.setdefault(robot, None) is not None
            asked_ns = self._asked_ns.get(robot)
            if asked_ns is None or now_ns - asked_ns > (ASK_AGAIN_NS if known else ASK_UNHEARD_NS):
                self._asked_ns[robot] = now_ns
                self._wire.ask_into(self._inbox, ROBOT_PLUGINS, ROBOT_PLUGINS, robot=robot)
        for received in self._inbox.drain():
            try:
                infos = self._decoder.decode(received.message)
            except (msgspec.DecodeError, UnicodeDecodeError):
                continue  # a robot that speaks otherwise may be able to do anything
            self.plugins[received.names["robot"]] = frozenset(info.name for info in infos)
        return self.plugins != before

    def came(self, robot: str) -> None:
        """A robot came, maybe with other plugins than before: it is asked anew."""
        self._asked_ns.pop(robot, None)
