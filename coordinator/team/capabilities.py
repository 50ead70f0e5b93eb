"""Abilities of the robots: plugins and kinds of tasks of each, as their hosts report them."""

import zlib
from collections.abc import Iterable, Iterator

import msgspec

from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.message import JsonSchema
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS, TaskKind
from robrain.protocol.messages.tasks.task_messages import KnownKind
from robrain.protocol.wire.endpoint import Endpoint

ASK_AGAIN_NS = to_ns(10.0)
"""Plugins are loaded and unloaded while a robot runs (chosen)."""
ASK_AGAIN_REPORTED_NS = to_ns(60.0)
"""Of a robot whose state reports that they have changed."""
ASK_UNHEARD_NS = to_ns(2.0)
"""One that has not answered in the time that a query has is asked again."""
ASKED_MOST = 32
"""Number of robots that are asked at a time, as an answer is long. Of a thousand robots that come at once, one is asked
after another."""


class Capabilities:
    """Asks each robot for its plugins when it comes and now and then, without waiting for the answers.

    Args:
        wire: the coordinator's place on the wire.

    """

    def __init__(self, wire: Endpoint) -> None:
        self.plugins: dict[str, frozenset[str] | None] = {}
        """Each robot that ever came: its name, plugins and kinds of tasks; None until it has reported them."""
        self.kinds: dict[str, dict[str, TaskKind]] = {}
        """The kinds of tasks that each robot announces."""
        self.version = 0
        """Grows whenever `kinds` changes."""
        self._announcements: dict[str, dict[str, int]] = {}
        self._wire = wire
        self._inbox = Inbox()
        self._asked_ns: dict[str, int] = {}
        self._loaded: dict[str, int] = {}
        """`RobotState.loaded` of each when it was last asked."""
        self._waiting: set[str] = set()

    def follow(self, robots: Iterable[Robot], now_ns: int) -> bool:
        """Handle answers, and query those of the present `robots` that are due; True if anything has changed."""
        has_changed = False
        self._waiting = {name for name in self._waiting if now_ns - self._asked_ns.get(name, 0) <= ASK_UNHEARD_NS}
        due: list[tuple[int, str, int]] = []
        for robot in robots:
            name, loaded = robot.name, robot.state.loaded if robot.state is not None else 0
            asked_ns = self._asked_ns.get(name)
            if asked_ns is not None and loaded == self._loaded.get(name, 0):
                known = self.plugins.get(name) is not None
                again_ns = (ASK_AGAIN_REPORTED_NS if loaded else ASK_AGAIN_NS) if known else ASK_UNHEARD_NS
                if now_ns - asked_ns <= again_ns:
                    continue
            if name not in self.plugins:
                self.plugins[name] = None
                has_changed = True
            due.append((-1 if asked_ns is None else asked_ns, name, loaded))
        for _, name, loaded in sorted(due)[: max(0, ASKED_MOST - len(self._waiting))]:
            self._asked_ns[name], self._loaded[name] = now_ns, loaded
            self._waiting.add(name)
            self._wire.ask_into(self._inbox, ROBOT_PLUGINS, ROBOT_PLUGINS, robot=name)
        for received in self._inbox.drain():
            self._waiting.discard(received.names["robot"])
            name, infos = received.names["robot"], received.message
            kinds = {info.task_kind.kind: info.task_kind for info in infos if info.task_kind is not None}
            plugins = frozenset((name, *(info.name for info in infos), *kinds))
            if self.plugins.get(name) != plugins or self.kinds.get(name) != kinds:
                has_changed = True
                self.plugins[name], self.kinds[name] = plugins, kinds
                encoded = {kind: msgspec.json.encode(one, order="deterministic") for kind, one in kinds.items()}
                self._announcements[name] = {kind: zlib.crc32(one) for kind, one in encoded.items()}
                self.version += 1
        return has_changed

    def announcements(self, kind: str) -> Iterator[tuple[str, int]]:
        """The robots that do a kind of task, each with a number that is equal where they announce it alike."""
        for robot in sorted(self._announcements):
            if kind in self._announcements[robot]:
                yield robot, self._announcements[robot][kind]

    def schemas(self) -> dict[str, list[JsonSchema]]:
        """The schemas of the parameters of each kind that robots announce, each that differs once."""
        schemas: dict[str, list[JsonSchema]] = {}
        for one in self.known_kinds():
            schemas.setdefault(one.kind, []).append(one.parameters)
        return schemas

    def known_kinds(self) -> list[KnownKind]:
        """The kinds of tasks that robots of the team do, by name; twice where robots announce one differently."""
        found: dict[bytes, KnownKind] = {}
        for robot in sorted(self.kinds):
            for kind, one in self.kinds[robot].items():
                announced = msgspec.json.encode([kind, one.parameters], order="deterministic")
                known = found.get(announced) or KnownKind(kind=kind, doc=one.doc, parameters=one.parameters)
                found[announced] = msgspec.structs.replace(known, robots=[*known.robots, robot])
        return sorted(found.values(), key=lambda known: (known.kind, known.robots))

    def came(self, robot: str) -> None:
        """A robot came, maybe with other plugins than before: it is asked again."""
        self._asked_ns.pop(robot, None)
