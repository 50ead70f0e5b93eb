"""Parts of other distributions: they receive, decide, assign and report like robrain's own."""

from collections.abc import Iterator, Sequence

import pytest
from msgspec.structs import replace

from robrain.coordinator.core.core import COORDINATOR_PARTS, CoordinatorPart, Core
from robrain.coordinator.team.roster import Robot
from robrain.protocol.border.border import Received
from robrain.protocol.clock import VirtualClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import TaskReason, plain
from robrain.protocol.table.topics import TOPICS, topic_of
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.recording.export.recording import Recording
from robrain.recording.replay.replay import Replay
from robrain.recording.writer.recorder import Recorder
from tests.coordinator.conftest import Team
from tests.installed_distributions import as_new, install, new_topics  # noqa: F401 - fixtures
from tests.recording.stage import PROVENANCE


class Patrol(CoordinatorPart):
    """Sends each idle robot to one place, once."""

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self.sent: list[str] = []
        self.received: list[str] = []
        self.refusal: TaskReason | None = None
        self.is_closed = False
        self.subscribe(ROBOT_PATH)

    def handle(self, received: Received, now_ns: int) -> None:
        self.received.append(received.message.robot)

    def assign(self, robots: Sequence[Robot], now_ns: int) -> None:
        for robot in self.core.idle(robots):
            if robot.name not in self.sent:
                self.sent.append(robot.name)
                task = Task(id=self.core.new_id("patrol"), kind=VISIT, place=Point2D(6.0, 4.0))
                self.core.offer_own(task, robot.name, now_ns)

    def offer_refusal(self) -> TaskReason | None:
        return self.refusal

    def summary(self, state: TeamState, now_ns: int) -> TeamState:
        return replace(state, tasks_done=len(self.sent))

    def close(self) -> None:
        self.is_closed = True


def broken(_core: Core) -> CoordinatorPart:
    raise ZeroDivisionError("a defect")


@pytest.fixture
def team(monkeypatch: pytest.MonkeyPatch) -> Iterator[Team]:
    parts = as_new(COORDINATOR_PARTS, monkeypatch)
    parts.register("patrol", Patrol)
    parts.register("broken", broken)
    with open_lockstep_session() as session:
        team = Team(session)
        yield team
        team.close()


@pytest.mark.sets_aside
def test_a_part_of_another_distribution_acts_and_reports(team: Team) -> None:
    robot = team.robot("r1", 4.0)
    robot.plugins = ["visit"]
    team.run(1.0)
    assert next(offer.task.kind for offer in robot.offers) == VISIT
    summary = team.summary
    assert summary.tasks_done == 1
    assert ("stage", "coordinator part broken", "failed") in [(one.topic, one.key, one.code) for one in summary.refused]
    patrol = team.coordinator.part(Patrol)
    team.coordinator.close()
    assert patrol.is_closed


@pytest.mark.sets_aside
def test_a_part_may_hold_back_what_was_submitted(team: Team) -> None:
    robot = team.robot("r1", 4.0)
    robot.plugins = ["visit"]
    patrol = team.coordinator.part(Patrol)
    patrol.sent, patrol.refusal = ["r1"], plain("not_now", "not now")
    team.run(0.5)
    team.coordinator.tasks.add(Task(id="t1", kind=VISIT, place=Point2D(5.0, 4.0)), by="ann")
    team.run(1.0)
    assert [offer for offer in robot.offers if offer.task.kind == VISIT] == []
    patrol.refusal = None
    team.run(1.5)
    assert [offer.task.id for offer in robot.offers if offer.task.kind == VISIT] == ["t1"]


PATROL = """
from typing import Annotated

from msgspec import Meta

from robrain.coordinator.core.core import CoordinatorPart
from robrain.protocol.messages.message import Message
from robrain.protocol.topic import Topic


class Rounds(Message, frozen=True, kw_only=True):
    rounds: Annotated[int, Meta(ge=0, le=1000)]


ROUNDS = Topic("coordinator/patrol/rounds", "Finished rounds", Rounds, recorded=True)


class Patrol(CoordinatorPart):
    def __init__(self, core):
        super().__init__(core)
        self.rounds = core.wire.publisher(ROUNDS)

    def reported(self, now_ns):
        self.rounds.put(Rounds(rounds=7))
"""


@pytest.mark.usefixtures("new_topics")
def test_topic_of_another_distribution_is_recorded_read_back_and_replayed(monkeypatch, install, tmp_path) -> None:  # noqa: F811
    as_new(COORDINATOR_PARTS, monkeypatch)
    install("patrol-part", {"patrol": "patrol:Patrol"}, {"patrol.py": PATROL}, COORDINATOR_PARTS.group)
    install("patrol-topics", {"patrol": "patrol"}, {}, TOPICS.group)
    with open_lockstep_session() as session:
        team = Team(session)
        recorder = Recorder(team.endpoint(), tmp_path / "run.mcap", PROVENANCE)
        team.robot("r1", 4.0)
        team.run(1.0)
        recorder.close()
        team.close()
    messages = list(Recording(tmp_path / "run.mcap").messages("coordinator_patrol_rounds"))
    assert messages
    assert {told.message.rounds for told in messages} == {7}
    with open_lockstep_session() as session:
        wire = Endpoint(session, "default", VirtualClock(), Drive.LOCKSTEP)
        received = Inbox(every=True)
        wire.subscribe(received, topic_of("robrain/default/coordinator/patrol/rounds")[0])
        replay = Replay(wire, tmp_path / "run.mcap")
        replay.seek(0.9)
        replay.close()
    assert received.drain()
