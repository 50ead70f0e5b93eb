"""The chargers that each robot knows, and its start place, queried from the robot; and the power of the chargers."""

from collections.abc import Mapping
from contextlib import suppress
from typing import NamedTuple

import msgspec

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.messages.robots.robot_messages import BatteryState
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
USUAL_W = 20.0
"""Of a charger at which no robot has charged yet. Chosen: a dock of 40 W, less a small robot's own consumption and the
slower last part of a charge."""
LEAST_W = 1.0
"""Lower bound of a learned power, so that every charge has an end."""
WINDOW_NS = to_ns(10.0)
"""Interval over which the power is measured, against noise in the reported energy."""
KEPT = 256
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


class _Begun(NamedTuple):
    charger: Point2D
    remaining_j: float
    stamp_ns: int


class ChargePower:
    """Learns the power of each charger; the latest measurement counts."""

    def __init__(self) -> None:
        self._power_w: dict[Point2D, float] = {}
        self._begun: dict[str, _Begun] = {}

    def of(self, charger: Point2D) -> float:
        """Power into the battery in watts, above 0."""
        known = self._known(charger)
        return USUAL_W if known is None else self._power_w[known]

    def record(self, robot: str, charger: Point2D, battery: BatteryState, now_ns: int) -> None:
        """Record a battery state of a robot that is charged at a charger."""
        begun = self._begun.get(robot)
        if begun is None or not is_same_charger(begun.charger, charger):
            self._begun[robot] = _Begun(charger, battery.remaining_j, now_ns)
        elif now_ns - begun.stamp_ns >= WINDOW_NS:
            power_w = (battery.remaining_j - begun.remaining_j) / to_seconds(now_ns - begun.stamp_ns)
            known = self._known(charger)
            self._power_w[charger if known is None else known] = max(LEAST_W, power_w)
            while len(self._power_w) > KEPT:
                del self._power_w[next(iter(self._power_w))]
            self._begun[robot] = _Begun(charger, battery.remaining_j, now_ns)

    def stop(self, robot: str) -> None:
        """A robot is no longer charged."""
        self._begun.pop(robot, None)

    def _known(self, charger: Point2D) -> Point2D | None:
        return next((place for place in self._power_w if is_same_charger(place, charger)), None)


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
        self.power = ChargePower()
        self._wire = wire
        self._plugins = plugins
        self._inbox = Inbox()
        self._due_ns: dict[str, int] = {}
        self._pause_ns: dict[str, int] = {}
        self._seen_ns: dict[str, int] = {}

    def least_w(self, robot: str) -> float:
        """Power of the slowest charger that a robot knows; 0 if it knows none."""
        return min((self.power.of(charger.place) for charger in self.of.get(robot, ())), default=0.0)

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
