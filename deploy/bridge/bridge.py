"""Carries what rules allow from one team to another. Nothing else passes, and nothing passes twice.

What is carried keeps its payload; only the team in its key changes. An attachment lists the sides it has been on. A
bridge does not carry it to a side in that list, so bridges in a ring do no harm; `HOPS_MAX` bounds a ring whose bridges
name their networks wrongly. Tokens are not carried: a robot is a member of one team.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec
import zenoh

from robrain.deploy.bridge.bridge_rules import ROBOT, BridgeRules, PassRule, Side, passable_query, passable_topic
from robrain.deploy.bridge.waiting import Message, Waiting
from robrain.protocol.wire.answers.asked import BY, ZenohQuery, answer_of
from robrain.protocol.wire.answers.later import ZENOH_TIMEOUT, call_error
from robrain.protocol.wire.border.border import Border
from robrain.protocol.wire.border.codec import BadPayload
from robrain.protocol.wire.border.refusals import Refusals
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.errors import CallError, ErrorCode
from robrain.protocol.wire.keys import ROOT
from robrain.protocol.wire.links.qos import publisher_options, query_options
from robrain.protocol.wire.topic import Query, Topic
from robrain.protocol.wire.topics import ROBOT_ALIVE

logger = logging.getLogger(__name__)

MARK = b"robrain-bridge "
HOPS_MAX = 8
MARK_MAX = 4096
WAITING_MAX = 4096
"""Messages that wait to be carried, in each direction of a rule. Queries are refused above `QUERIES_MAX`."""
QUERIES_MAX = 256


class Counts(msgspec.Struct, kw_only=True):
    """What a bridge has done in one direction."""

    carried: int = 0
    """Messages."""
    answered: int = 0
    """Queries, with an answer or an error of the other side."""
    unanswered: int = 0
    """Queries that got an error of the bridge."""
    looped: int = 0
    """Messages and queries that had been on the other side already."""
    refused: int = 0
    """Messages that break the contract of their topic."""
    doubled: int = 0
    """Messages of a robot of whose name the other side has one too."""
    dropped: int = 0
    """Messages that came faster than they could be carried."""


class _Asked(NamedTuple):
    query: ZenohQuery
    replies: Any
    topic: Query[Any, Any]


class Bridge:
    """Joins two teams.

    Args:
        rules: what passes.
        sessions: a session for each side; not closed by the bridge. A session that has both sides is given twice.

    """

    def __init__(self, rules: BridgeRules, sessions: dict[str, zenoh.Session]) -> None:
        self._present = {
            name: _Robots(Endpoint(sessions[name], side.team, WallClock(), Drive.LIVE))
            for name, side in rules.sides.items()
        }
        self._ways = [_Way(rule, rules.sides, sessions, self._present) for rule in rules.rules]
        self._rules = rules.rules

    @property
    def counts(self) -> dict[str, Counts]:
        """By direction, such as `north to south`; rules of one direction together."""
        found: dict[str, Counts] = {}
        for rule, way in zip(self._rules, self._ways, strict=True):
            total = found.setdefault(f"{rule.source} to {rule.target}", Counts())
            for field in Counts.__struct_fields__:
                setattr(total, field, getattr(total, field) + getattr(way.counts, field))
        return found

    def step(self) -> None:
        """Carry what waits."""
        for robots in self._present.values():
            robots.step()
        for way in self._ways:
            way.step()

    def on_waiting(self, wake: Callable[[], None]) -> None:
        """Call `wake`, on Zenoh's threads, whenever `step` has something to do."""
        for way in self._ways:
            way.wake = wake

    def close(self) -> None:
        """Carry nothing any more; queries that wait get an error."""
        for way in self._ways:
            way.close()
        for robots in self._present.values():
            robots.close()


class _Robots:
    """Names of the robots that are present on one side."""

    def __init__(self, wire: Endpoint) -> None:
        self._wire = wire
        self._presence = wire.watch(ROBOT_ALIVE)
        self.names: set[str] = set()

    def step(self) -> None:
        for change in self._presence.changes():
            (self.names.add if change.present else self.names.discard)(change.names[ROBOT])

    def close(self) -> None:
        self._wire.close()


class _Way:
    """One rule: one direction."""

    def __init__(
        self, rule: PassRule, sides: dict[str, Side], sessions: dict[str, zenoh.Session], present: dict[str, _Robots]
    ) -> None:
        self.counts = Counts()
        self.wake: Callable[[], None] = lambda: None
        self._source, self._target = sides[rule.source], sides[rule.target]
        self._from, self._to = sessions[rule.source], sessions[rule.target]
        self._here, self._there = present[rule.source], present[rule.target]
        self._robots = frozenset(rule.robots)
        self._border = Border(WallClock(), Refusals(WallClock()))
        self._messages = Waiting(WAITING_MAX)
        self._queries: deque[tuple[zenoh.Query, Query[Any, Any], bytes]] = deque()
        self._lock = threading.Lock()
        self._asked: list[_Asked] = []
        self._queryables: dict[str, list[Any]] = {}
        self._query_topics = [passable_query(name) for name in rule.queries]
        self._subscribers = [self._subscribe(passable_topic(name)) for name in rule.topics]

    def step(self) -> None:
        with self._lock:
            messages = self._messages.take()
            queries, self._queries = self._queries, deque()
        for message in messages:
            self._carry(message)
        for query, topic, mark in queries:
            self._ask(ZenohQuery(query), topic, mark)
        self._asked = [asked for asked in self._asked if not self._is_answered(asked)]
        self._follow_robots()

    def close(self) -> None:
        for declared in (*self._subscribers, *(one for group in self._queryables.values() for one in group)):
            declared.undeclare()
        gone = CallError(ErrorCode.UNLOADED, "the bridge ends")
        for query, _, _ in self._queries:
            self._refuse(ZenohQuery(query), gone)
        for asked in self._asked:
            self._refuse(asked.query, gone)
        self._subscribers, self._queryables, self._asked = [], {}, []
        self._queries.clear()

    # -- what is said ---------------------------------------------------------------------------------------

    def _subscribe(self, topic: Topic[Any]) -> Any:
        def heard(sample: zenoh.Sample) -> None:
            mark = b"" if sample.attachment is None else sample.attachment.to_bytes()
            payload = sample.payload.to_bytes()
            with self._lock:
                dropped = self._messages.put(Message(topic, str(sample.key_expr), payload, mark))
                self.counts.dropped += dropped
            self.wake()

        callback: Any = zenoh.handlers.Callback(heard, indirect=False)
        return self._from.declare_subscriber(topic.selector(self._source.team), callback)

    def _carry(self, message: Message) -> None:
        topic = message.topic
        received = self._border.read(topic, message.key, message.payload)
        if received is None:
            self.counts.refused += 1
            return
        robot = received.names.get(ROBOT, "")
        if self._robots and robot and robot not in self._robots:
            return
        mark = self._next_mark(message.mark)
        if mark is None:
            self.counts.looped += 1
            return
        if robot in self._there.names:
            self.counts.doubled += 1
            return
        self._to.put(
            self._key_there(message.key),
            message.payload,
            attachment=mark,
            **publisher_options(topic),
        )
        self.counts.carried += 1

    # -- what is asked --------------------------------------------------------------------------------------

    def _follow_robots(self) -> None:
        """Answer for the robots there are on the other side, and not on this one too."""
        wanted = self._there.names - self._here.names
        if self._robots:
            wanted &= self._robots
        for robot in self._queryables.keys() - wanted:
            for queryable in self._queryables.pop(robot):
                queryable.undeclare()
        for robot in wanted - self._queryables.keys() if self._query_topics else ():
            self._queryables[robot] = [self._answer(topic, robot) for topic in self._query_topics]

    def _answer(self, topic: Query[Any, Any], robot: str) -> Any:
        def asked(query: zenoh.Query) -> None:
            mark = b"" if query.attachment is None else query.attachment.to_bytes()
            with self._lock:
                is_full = len(self._queries) + len(self._asked) >= QUERIES_MAX
                if not is_full:
                    self._queries.append((query, topic, mark))
            if is_full:
                self._refuse(ZenohQuery(query), CallError(ErrorCode.BUSY, "the bridge has too many queries"))
            self.wake()

        callback: Any = zenoh.handlers.Callback(asked, indirect=False)
        return self._from.declare_queryable(topic.selector(self._source.team, robot=robot), callback)

    def _ask(self, query: ZenohQuery, topic: Query[Any, Any], before: bytes) -> None:
        mark = self._next_mark(before)
        if mark is None:
            self.counts.looped += 1
            self._refuse(query, CallError(ErrorCode.REFUSED, "the question has been on the other side already"))
            return
        if topic.parse(query.key) is None:
            self._refuse(query, CallError(ErrorCode.BAD_ARGUMENTS, f"{query.key}: ask one concrete key"))
            return
        try:
            topic.requests.read(query.payload)
        except BadPayload as error:
            self.counts.refused += 1
            self._refuse(query, CallError(ErrorCode.BAD_ARGUMENTS, str(error)))
            return
        by = f"?{BY}={query.by}" if query.by else ""
        replies = self._to.get(
            self._key_there(query.key) + by,
            zenoh.handlers.FifoChannel(64),
            payload=query.payload or None,
            timeout=topic.timeout_s,
            attachment=mark,
            **query_options(topic.urgency),
        )
        self._asked.append(_Asked(query, replies, topic))

    def _is_answered(self, asked: _Asked) -> bool:
        """Pass on an answer, if there is one by now."""
        try:
            reply = asked.replies.try_recv()
        except zenoh.ZError:  # the end, and no reply came
            self._refuse(asked.query, CallError(ErrorCode.TIMEOUT, "nobody on the other side answers"))
            return True
        if reply is None:
            return False
        answer = answer_of(reply)
        try:
            if answer.is_error:
                is_theirs = answer.payload != ZENOH_TIMEOUT
                self._refuse(asked.query, call_error(answer.payload), is_theirs=is_theirs)
            else:
                asked.topic.payloads.read(answer.payload)
                asked.query.reply(asked.query.key, answer.payload, asked.topic.encoding)
                asked.query.end()
                self.counts.answered += 1
        except zenoh.ZError:  # who asked has gone
            self.counts.unanswered += 1
        except BadPayload as error:
            self.counts.refused += 1
            self._refuse(asked.query, CallError(ErrorCode.FAILED, f"the answer does not decode: {error}"))
        return True

    def _refuse(self, query: ZenohQuery, error: CallError, *, is_theirs: bool = False) -> None:
        if is_theirs:
            self.counts.answered += 1
        else:
            self.counts.unanswered += 1
        try:
            query.reply_error(error)
        except zenoh.ZError as closed:
            logger.debug("%s: no reply can be sent any more: %s", query.key, closed)
        finally:
            query.end()

    # -- keys and marks -------------------------------------------------------------------------------------

    def _key_there(self, key: str) -> str:
        return "/".join((ROOT, self._target.team, *key.split("/")[2:]))

    def _next_mark(self, mark: bytes) -> bytes | None:
        """What is attached on the other side; None if it must not go there."""
        if len(mark) > MARK_MAX:
            return None
        sides = mark[len(MARK) :].decode(errors="replace").split() if mark.startswith(MARK) else []
        if self._target.id in sides or len(sides) >= HOPS_MAX:
            return None
        return MARK + " ".join([*sides, self._source.id]).encode()
