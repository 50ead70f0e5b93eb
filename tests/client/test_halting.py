"""A halt is sent before anything else is done, again until it is confirmed, and reported robot by robot."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
import zenoh

from robrain import NobodyThere, Team
from robrain.client.transport import Listening, Transport
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.messages.robots.host_messages import HOST_HALT, HaltAnswer
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.team import team_messages
from robrain.protocol.messages.team.team_messages import HALT, Halt, RobotSummary, TeamState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session


@dataclass
class ScriptedTransport(Transport):
    """Time passes only when it is waited for; robots then say what the test has them say."""

    session: zenoh.Session
    said: list[RobotState] = field(default_factory=list)
    summary: TeamState | None = None
    """Of a coordinator, after a second."""
    drive = Drive.LOCKSTEP
    team = "default"

    def __post_init__(self) -> None:
        self.clock = VirtualClock()
        self.wire = Endpoint(self.session, self.team, self.clock, self.drive)
        self.halts = Inbox()
        self.wire.subscribe(self.halts, HALT)
        self._summaries = self.wire.publisher(team_messages.COORDINATOR_STATE)
        self._states = {name: self.wire.publisher(ROBOT_STATE, robot=name) for name in ("r1", "r2")}

    def elapsed_s(self) -> float:
        return self.clock.now_ns() / 1e9

    def pass_time(self, seconds: float) -> None:
        self.clock.advance_to(self.clock.now_ns() + to_ns(seconds))
        for state in self.said:
            self._states[state.robot].put(state)
        if self.summary is not None and self.elapsed_s() > 1.0:
            self._summaries.put(self.summary)

    def close(self) -> None:
        self.wire.close()

    def heard(self) -> list[Halt]:
        return [received.message for received in self.halts.drain()]


@pytest.fixture
def transport() -> Iterator[ScriptedTransport]:
    session = open_lockstep_session()
    yield ScriptedTransport(session)
    session.close()


def test_a_halt_is_sent_before_anything_else_is_done(
    transport: ScriptedTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    with Team(transport, by="ann") as team:
        for owner, name in ((Publisher, "put"), (Endpoint, "publisher"), (Endpoint, "subscribe"), (Endpoint, "watch"),
                            (Endpoint, "ask"), (ScriptedTransport, "pass_time")):  # fmt: skip
            unwatched = getattr(owner, name)

            def watched(*arguments, name=name, unwatched=unwatched, **named):
                done.append(name)
                return unwatched(*arguments, **named)

            monkeypatch.setattr(owner, name, watched)
        transport.said = [RobotState(robot="r1", halted=True)]
        assert team.halt(reason="a cat").confirmed == ("r1",)
    assert done[0] == "put"
    (halt,) = transport.heard()
    assert (halt.halted, halt.by, halt.reason) == (True, "ann", "a cat")


def test_who_has_not_stopped_is_reported_with_what_is_known(transport: ScriptedTransport) -> None:
    transport.said = [RobotState(robot="r1", halted=True, not_halted=["arm"]), RobotState(robot="r2")]
    transport.wire.token(ROBOT_ALIVE, robot="r3")
    with Team(transport, by="ann") as team:
        report = team.halt()
    assert report.confirmed == ()
    assert report.unconfirmed == {
        "r1": "plugins that did not stop: arm",
        "r2": "it does not say that it has stopped",
        "r3": "it says nothing",
    }


def test_a_halt_is_sent_again_while_a_robot_has_not_stopped(transport: ScriptedTransport) -> None:
    transport.said = [RobotState(robot="r1", halted=True), RobotState(robot="r2")]
    with Team(transport, by="ann") as team:
        assert team.halt().unconfirmed.keys() == {"r2"}
        assert len(transport.heard()) == 10
        transport.said = [RobotState(robot=name, halted=True) for name in ("r1", "r2")]
        assert team.halt().unconfirmed == {}
        assert len(transport.heard()) == 1


def test_a_halt_is_not_confirmed_before_the_coordinator_has_listed_its_robots_also_those_out_of_reach(
    transport: ScriptedTransport,
) -> None:
    transport.said = [RobotState(robot="r1", halted=True)]
    transport.wire.token(team_messages.COORDINATOR_ALIVE)
    robots = [RobotSummary(name="r1", up=True, age_s=0.1), RobotSummary(name="r2", up=False, age_s=9.0, why="silent")]
    transport.summary = TeamState(robots=robots)
    with Team(transport, by="ann") as team:
        report = team.halt()
    assert report.confirmed == ("r1",)
    assert report.unconfirmed == {"r2": "silent"}


def test_a_single_robot_whose_plugin_does_not_stop_is_not_confirmed(transport: ScriptedTransport) -> None:
    answer = HaltAnswer(robot="r1", halted=True, not_halted=["arm"])
    transport.wire.answer(HOST_HALT, lambda _request: answer, robot="r1")
    with Team(transport, by="ann") as team:
        assert team.halt("r1").unconfirmed == {"r1": "plugins that did not stop: arm"}


def test_a_halt_of_nobody_is_sent_and_told(transport: ScriptedTransport) -> None:
    with (
        Team(transport, by="ann") as team,
        pytest.raises(NobodyThere, match="no robot of team default is there; the message was sent anyway"),
    ):
        team.halt()
    assert len(transport.heard()) == 10  # the first ones may be lost before the robots are known


def test_names_and_reasons_are_cut_to_what_a_halt_may_carry(transport: ScriptedTransport) -> None:
    transport.said = [RobotState(robot="r1", halted=True)]
    with Team(transport, by="a" * 500) as team:
        team.halt(reason="b" * 5000)
    (halt,) = transport.heard()
    assert (len(halt.by), len(halt.reason)) == (64, 200)


def test_endpoints_that_two_threads_open_at_once_are_two(transport: ScriptedTransport) -> None:
    listening = Listening(transport)
    others: list[Endpoint] = []

    class Interrupted(list[Endpoint]):
        def append(self, wire: Endpoint) -> None:
            super().append(wire)
            if len(self) == 1:
                others.append(listening.open())  # another thread's, at the worst moment

    listening._open = Interrupted()
    assert listening.open() is not others[0]
    listening.close()
