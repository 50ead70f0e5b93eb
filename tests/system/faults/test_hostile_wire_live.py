"""A live team goes on whatever a stranger sends under its keys: no process ends or grows, each refusal is counted."""

import json
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import psutil
import pytest

from robrain.protocol.codec import BadPayload
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.motes.mote_messages import MOTE_READING
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS
from robrain.protocol.messages.tasks.task_messages import TASK_LIST, TaskFilter
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE
from robrain.protocol.table.topics import all_rows, all_topics
from robrain.protocol.topic import Delivery, Query, Topic
from robrain.protocol.wire.endpoint import Endpoint
from tests.hostile_payloads import fixed_payloads
from tests.system.conftest import Commands, member_at
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

NAMES = {"robot": "r1", "mote": "m1", "plugin": "driver", "function": "stop", "verb": "hold", "event": "e"}
NAMES |= {"image": "i", "recorder": "rec_x", "channel": "can0", "line": "lidar", "door": "gate"}
ROUNDS = 3
SETTLED_ROUNDS = 2
"""Rounds after which a process has whatever buffers it needs for large payloads."""
GROWTH_MAX_MB = 60.0
"""What a process may grow by in each round after that: less than what one round sends."""
HARMLESS_BYTES = 5_000_000
"""Larger payloads are left out: they test Zenoh's patience on loopback, not robrain."""


class Hub:
    """A team of `robrain up`, and a stranger on its hub."""

    def __init__(self, folder: Path) -> None:
        self.commands = Commands(folder)
        self.process = self.commands.start("up", "arena_small", "--robots", "1", "--motes", "1", "--port", "0",
                                           "--record", "run.mcap")  # fmt: skip
        self.address = self.commands.line_with(self.process, "hub: ").split()[1]
        self._closing = ExitStack()
        self.wire = self._closing.enter_context(member_at(self.address))
        self._recorders = Inbox(every=True)
        self.refused: Counter[str] = Counter()
        """What the recorder has refused, by topic, as it told last."""
        self.dropped: Counter[str] = Counter()
        """What came faster than it writes, good or bad."""
        self.wire.subscribe(self._recorders, RECORDER_STATE, recorder="rec_run")

    def family(self) -> dict[int, str]:
        """The process and its children, each with its command."""
        words_of = {child.pid: child.cmdline() for child in psutil.Process(self.process.pid).children()}
        children = {pid: " ".join(words[1:4]) for pid, words in words_of.items() if "robrain.cli" in words}
        return {self.process.pid: "up", **children}

    def resident_mb(self) -> dict[int, float]:
        return {pid: psutil.Process(pid).memory_info().rss / 1048576 for pid in self.family()}

    def look_at_recorder(self) -> None:
        """Take in what the recorder has told since the last look."""
        for received in self._recorders.drain():
            told, self.dropped = received.message.refused, Counter[str]()
            self.refused = Counter[str]()
            for one in told if isinstance(told, list) else ():
                self.refused[one.topic] += one.count
            for lost in received.message.lost:
                self.dropped[lost.topic] += lost.messages

    def is_served(self) -> bool:
        """Whether good queries are answered; on a busy machine a reply may come late."""
        try:
            self.wire.ask(TASK_LIST, TaskFilter())
            return bool(self.wire.ask(ROBOT_PLUGINS, robot="r1"))
        except (CallError, NobodyThere):
            return False

    def close(self) -> None:
        self._closing.close()
        self.commands.stop_all()


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hub]:
    hub = Hub(tmp_path_factory.mktemp("hostile"))
    until(hub.is_served)
    yield hub
    hub.close()


def is_bad(topic: Topic[Any], payload: bytes) -> bool:
    try:
        message = topic.payloads.read(payload)
    except BadPayload:
        return True
    return any(getattr(message, field) != NAMES[field] for field in topic.named_twice)


def payloads_of(row: Topic[Any] | Query[Any, Any]) -> list[bytes]:
    return [payload for payload in fixed_payloads(row) if len(payload) <= HARMLESS_BYTES]


def test_no_process_ends_or_grows_whatever_is_said_and_asked(hub: Hub) -> None:
    family = hub.family()
    for command in ("arena", "coordinator", "agent", "dashboard"):
        assert any(words.endswith(command) for words in family.values()), family
    bad: Counter[str] = Counter()
    resident_mb = []
    for _ in range(ROUNDS):
        bad += _say_and_ask_all(hub)
        resident_mb.append(hub.resident_mb())
    assert (hub.process.poll(), hub.family()) == (None, family)
    settled = resident_mb[SETTLED_ROUNDS - 1 :]
    grown = {family[pid]: min(after[pid] - before[pid] for before, after in pairwise(settled)) for pid in family}
    assert max(grown.values()) < GROWTH_MAX_MB, grown

    lossless = {topic.name for topic in all_topics() if topic.recorded and topic.delivery is Delivery.LOSSLESS}
    expected = {name: count for name, count in bad.items() if name in lossless}

    def unaccounted() -> dict[str, int]:
        hub.look_at_recorder()
        missing = {name: count - hub.refused[name] - hub.dropped[name] for name, count in expected.items()}
        return {name: count for name, count in missing.items() if count > 0}

    deadline_s = time.monotonic() + PATIENCE_S
    while unaccounted() and time.monotonic() < deadline_s:
        time.sleep(0.1)
    assert unaccounted() == {}
    assert all(hub.refused[name] <= count for name, count in bad.items())
    recorded = {topic.name for topic in all_topics() if topic.recorded and bad[topic.name]}
    assert set(hub.refused) <= recorded
    # Of topics whose last message is enough Zenoh may have dropped all bad ones; it counts none.
    assert recorded & lossless <= set(hub.refused) | set(hub.dropped)
    refused = _refused(hub)
    assert refused["coordinator"][MOTE_READING.name] == bad[MOTE_READING.name]
    assert "r1" in refused


def test_a_halted_team_resumes_and_drives_after_it(hub: Hub) -> None:
    done = hub.commands.run_until(lambda result: result.returncode == 0, "resume", "--connect", hub.address)
    assert "1 of 1 robots resumed" in done.stdout


def _say_and_ask_all(hub: Hub) -> Counter[str]:
    """Everything once, and after each topic and query what is good; the numbers of bad messages by topic."""
    bad: Counter[str] = Counter()
    for topic in all_topics():
        publisher = hub.wire.publisher(topic, **{field: NAMES[field] for field in topic.fields})
        for payload in payloads_of(topic):
            publisher.put_bytes(payload)
            bad[topic.name] += is_bad(topic, payload)
        until(hub.is_served, f"nobody is served after {topic.name}")
    for row in all_rows():
        if isinstance(row, Query):
            for payload in payloads_of(row):
                _ask(hub.wire, row, payload)
            until(hub.is_served, f"nobody is served after {row.name}")
    return bad


def _ask(wire: Endpoint, query: Query[Any, Any], payload: bytes) -> None:
    """Ask with a payload as it is: there is a reply, and to a bad request it is `bad_arguments`."""
    key = query.key("default", **{field: NAMES[field] for field in query.fields})
    replies = list(wire.session.get(key, payload=payload, timeout=PATIENCE_S))
    try:
        query.requests.read(payload)
    except BadPayload:
        errors = [json.loads(reply.err.payload.to_bytes()) for reply in replies if reply.err is not None]
        assert [error["code"] for error in errors] == [ErrorCode.BAD_ARGUMENTS] * len(replies), (
            query.name,
            payload[:80],
        )


def _refused(hub: Hub) -> dict[str, dict[str, int]]:
    """Refused messages by member and topic, as `robrain status` tells."""
    result = hub.commands.run("status", "--json", "--connect", hub.address)
    counts: dict[str, dict[str, int]] = {}
    for member, refused in json.loads(result.stdout).get("refused", {}).items():
        for one in refused:
            topics = counts.setdefault(member, {})
            topics[one["topic"]] = topics.get(one["topic"], 0) + one["count"]
    return counts
