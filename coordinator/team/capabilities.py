"""Who can do what: the plugins of each robot, as their hosts tell them."""

from collections.abc import Iterable

from robrain.coordinator.team.roster import Robot
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import ROBOT_PLUGINS

ASK_AGAIN_NS = to_ns(10.0)
"""Plugins are loaded and unloaded while a robot runs (chosen)."""
ASK_AGAIN_TOLD_NS = to_ns(60.0)
"""Of a robot whose state tells that they have changed."""
ASK_UNHEARD_NS = to_ns(2.0)
"""One that has not answered in the time that a query has is asked again."""
ASKED_MOST = 32
"""So many are asked at a time, for an answer is long: of a thousand robots that come at once, one after another."""


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
        self._told: dict[str, int] = {}
        """`RobotState.loaded` of each when it was last asked."""
        self._waiting: set[str] = set()

    def follow(self, robots: Iterable[Robot], now_ns: int) -> bool:
        """Take in what was answered, and ask these robots, which are there, if it is time; True if there is news."""
        news = False
        self._waiting = {name for name in self._waiting if now_ns - self._asked_ns.get(name, 0) <= ASK_UNHEARD_NS}
        due: list[tuple[int, str, int]] = []
        for robot in robots:
            name, told = robot.name, robot.state.loaded if robot.state is not None else 0
            asked_ns = self._asked_ns.get(name)
            if asked_ns is not None and told == self._told.get(name, 0):
                known = self.plugins.get(name) is not None
                again_ns = (ASK_AGAIN_TOLD_NS if told else ASK_AGAIN_NS) if known else ASK_UNHEARD_NS
                if now_ns - asked_ns <= again_ns:
                    continue
            if name not in self.plugins:
                self.plugins[name] = None
                news = True
            due.append((-1 if asked_ns is None else asked_ns, name, told))
        for _, name, told in sorted(due)[: max(0, ASKED_MOST - len(self._waiting))]:
            self._asked_ns[name], self._told[name] = now_ns, told
            self._waiting.add(name)
            self._wire.ask_into(self._inbox, ROBOT_PLUGINS, ROBOT_PLUGINS, robot=name)
        for received in self._inbox.drain():
            self._waiting.discard(received.names["robot"])
            name, plugins = received.names["robot"], frozenset(info.name for info in received.message)
            news = news or self.plugins.get(name) != plugins
            self.plugins[name] = plugins
        return news

    def came(self, robot: str) -> None:
        """A robot came, maybe with other plugins than before: it is asked anew."""
        self._asked_ns.pop(robot, None)
