"""Whatever is sent under whatever key, a team goes on: the bad message is refused and counted, the next one served.

A lockstep run with coordinator, robots, arena and recorder, and a dashboard's view of it, all on one session.
"""

import json
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.dashboard.state.live_source import LiveSource
from robrain.protocol.codec import BadPayload
from robrain.protocol.errors import ErrorCode
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS
from robrain.protocol.messages.tasks.task_messages import TASK_LIST, TaskFilter
from robrain.protocol.schema.document import errors_of
from robrain.protocol.table.topics import all_rows, all_topics
from robrain.protocol.topic import Query, Topic
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.scenarios.scenario import Scenario
from tests.hostile_payloads import payloads

pytestmark = pytest.mark.slow

QUERIES = [row for row in all_rows() if isinstance(row, Query)]
NAMES = {"robot": "r1", "mote": "m1", "plugin": "driver", "function": "stop", "verb": "hold", "event": "e"}
NAMES |= {"image": "i", "recorder": "rec_x", "channel": "can0", "line": "lidar", "door": "gate"}
EXAMPLES, BATCH = 5, 5
REFUSED_CODES = {"malformed", "too_large", "wrong_name", "from_future"}


class Team:
    """A run, a dashboard's view of it, and a stranger on its wire."""

    def __init__(self) -> None:
        world = Scenario.builtin("arena_small").replace(robots=2, motes=2, seed=5).world()
        self.run = LockstepRun(world, session=open_lockstep_session())
        self.dashboard = Endpoint(self.run.session, "default", self.run.clock, Drive.LOCKSTEP)
        self.source = LiveSource(self.dashboard)
        self.stranger = Endpoint(self.run.session, "default", self.run.clock, Drive.LOCKSTEP)
        for _ in range(50):
            self.tick()

    def tick(self) -> None:
        self.run.tick()
        self.source.receive(self.run.sim_time_s)

    def listeners(self) -> list[Endpoint]:
        hosts = [host.wire for host in self.run.hosts]
        return [*hosts, *self.run._endpoints, self.dashboard]

    def refused(self, topic: str) -> int:
        """How many messages of a topic all have refused."""
        others = [self.run.coordinator.refusals, self.run._recorder._refusals]
        refusals = [*(one.refusals for one in self.listeners()), *others]
        counts = {id(one): one.counts() for one in refusals}
        return sum(
            each.count for one in counts.values() for each in one if each.topic == topic and each.code in REFUSED_CODES
        )

    def is_served(self) -> None:
        """The next good messages are heard, and the next good queries answered, by everybody."""
        heard = self.run.messages
        assert self.stranger.ask(TASK_LIST, TaskFilter()) is not None
        for robot in ("r1", "r2"):
            assert self.stranger.ask(ROBOT_PLUGINS, robot=robot)
        for _ in range(6):
            self.tick()
        assert self.run.messages > heard
        seen = self.source.view.robots
        assert all(self.run.sim_time_s - seen[name].last_seen_s < 0.5 for name in ("r1", "r2"))

    def close(self) -> None:
        self.source.close()
        self.stranger.close()
        self.dashboard.close()
        self.run.close()


@pytest.fixture(scope="module")
def team() -> Iterator[Team]:
    team = Team()
    yield team
    team.close()


def is_bad(topic: Topic[Any], payload: bytes) -> bool:
    try:
        message = topic.payloads.read(payload)
    except BadPayload:
        return True
    return any(getattr(message, field) != NAMES[field] for field in topic.named_twice)


def batches(row: Topic[Any] | Query[Any, Any]) -> st.SearchStrategy[list[bytes]]:
    """Several payloads before the next tick, as ticks are what takes time."""
    return st.lists(payloads(row), min_size=BATCH, max_size=BATCH)


FUZZ = settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck), deadline=None)


@pytest.mark.parametrize("topic", all_topics(), ids=lambda topic: topic.name)
def test_a_bad_message_is_refused_and_counted_and_the_next_good_one_is_heard(team: Team, topic: Topic[Any]) -> None:
    publisher = team.stranger.publisher(topic, **{field: NAMES[field] for field in topic.fields})

    @FUZZ
    @given(several=batches(topic))
    def fuzz(several: list[bytes]) -> None:
        before = team.refused(topic.name)
        for payload in several:
            publisher.put_bytes(payload)
        for _ in range(2):
            team.tick()
        if topic.recorded:
            bad = sum(is_bad(topic, payload) for payload in several)
            assert team.refused(topic.name) >= before + bad, several

    fuzz()
    publisher.put_bytes(b" " * (topic.max_bytes + 1))
    team.is_served()


@pytest.mark.parametrize("query", QUERIES, ids=lambda query: query.name)
def test_a_bad_request_is_answered_in_words_and_counted_and_the_next_good_one_served(
    team: Team, query: Query[Any, Any]
) -> None:
    key = query.key("default", **{field: NAMES[field] for field in query.fields})

    @FUZZ
    @given(several=batches(query))
    def fuzz(several: list[bytes]) -> None:
        for payload in several:
            before = team.refused(query.name)
            replies: list[zenoh.Reply] = []
            team.run.session.get(key, zenoh.handlers.Callback(replies.append, indirect=False), payload=payload)
            assert len(replies) <= 1
            for reply in replies:
                if reply.err is not None:
                    answer = json.loads(reply.err.payload.to_bytes())
                    assert answer["code"] in errors_of(query)
                    assert answer["message"]
                try:
                    query.requests.read(payload)
                except BadPayload:
                    assert reply.err is not None
                    assert answer["code"] == ErrorCode.BAD_ARGUMENTS
                    assert team.refused(query.name) == before + 1
        team.tick()

    fuzz()
    team.is_served()
