"""The chargers that each robot knows, and its start place, queried from the robot."""

from collections.abc import Mapping
from contextlib import suppress

import msgspec

from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.endpoint import Endpoint

ASK_AGAIN_NS = to_ns(30.0)
"""Interval of the queries: a robot learns of chargers by tasks to recharge (chosen)."""
ASK_UNHEARD_NS = to_ns(2.0)
"""First pause after a query without an answer; it doubles each time, up to a minute."""
LONGEST_NS = to_ns(60.0)
ASKED_MAX = 32
"""Robots queried at once: a query to a thousand takes a quarter of a second, in which the team waits."""
PLUGIN = "home"
SAME_M = 0.6
"""Chargers closer together than this are the same charger; a robot this close to a charger is at it (chosen)."""


class _Charger(msgspec.Struct):
    x_m: float
    y_m: float
    yaw_rad: float | None = None


class Charger(msgspec.Struct, frozen=True):
    """A charger's place, arena frame."""

    place: Point2D
    yaw_rad: float | None = None


def is_same_charger(one: Point2D, other: Point2D) -> bool:
    """Whether two robots mean the same charger; their estimates of its place may differ."""
    return one.distance_m(other) < SAME_M


class KnownChargers:
    """Queries each robot's skill `home`, without waiting for the answers.

    Args:
        wire: the coordinator's Zenoh endpoint.
        plugins: announced plugins of each robot: only robots with `home` are queried. None queries all.

    """

    def __init__(self, wire: Endpoint, plugins: Mapping[str, frozenset[str] | None] | None = None) -> None:
        self.of: dict[str, tuple[Charger, ...]] = {}
        """Chargers of each robot that has answered."""
        self.home: dict[str, Point2D] = {}
        """Where each robot started; if it has not answered, where it was first seen."""
        self._wire = wire
        self._plugins = plugins
        self._inbox = Inbox()
        self._due_ns: dict[str, int] = {}
        self._pause_ns: dict[str, int] = {}
        self._seen_ns: dict[str, int] = {}

    def places(self) -> list[Point2D]:
        """Where any robot knows a charger."""
        return [charger.place for chargers in self.of.values() for charger in chargers]

    def follow(self, robots: dict[str, Point2D], now_ns: int) -> None:
        """Process the answers, and query these robots if it is time."""
        left = ASKED_MAX
        for robot, place in robots.items():
            self.home.setdefault(robot, place)
            if not self._may_have_it(robot, now_ns):
                continue
            if left and now_ns >= self._due_ns.get(robot, 0):
                left -= 1
                pause_ns = ASK_AGAIN_NS if robot in self.of else self._pause_ns.get(robot, ASK_UNHEARD_NS)
                self._due_ns[robot] = now_ns + pause_ns
                self._pause_ns[robot] = min(2 * pause_ns, LONGEST_NS)
                for function in ("chargers", "start"):
                    self._wire.ask_into(
                        self._inbox, ROBOT_CALL, ROBOT_CALL, robot=robot, plugin=PLUGIN, function=function
                    )
        for received in self._inbox.drain():
            robot = received.names["robot"]
            # An answer of another form counts as none: the robot ends where it was first seen.
            with suppress(msgspec.DecodeError, UnicodeDecodeError):
                if received.names["function"] == "start":
                    self.home[robot] = msgspec.json.decode(received.message, type=Point2D)
                else:
                    found = msgspec.json.decode(received.message, type=list[_Charger])
                    self.of[robot] = tuple(Charger(Point2D(one.x_m, one.y_m), one.yaw_rad) for one in found)

    def _may_have_it(self, robot: str, now_ns: int) -> bool:
        """Whether a robot has the plugin, or has not announced its plugins within the time limit."""
        if self._plugins is None:
            return True
        plugins = self._plugins.get(robot)
        if plugins is None:
            return now_ns >= self._seen_ns.setdefault(robot, now_ns) + ASK_UNHEARD_NS
        if PLUGIN not in plugins:
            self.of.pop(robot, None)  # it may have had it
        return PLUGIN in plugins

    def came(self, robot: str) -> None:
        """A robot joined, possibly another than before: query it again."""
        self._due_ns.pop(robot, None)
        self._pause_ns.pop(robot, None)
        self._seen_ns.pop(robot, None)
