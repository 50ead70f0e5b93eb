"""A replay can be paused, moved about and sped up, by keys and by queries."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from robrain.dashboard.state.shown_team import ShownTeam
from robrain.deploy.recordings.replaying import ReplayTerminal
from robrain.protocol.clock import LiveClock, VirtualClock
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.recorder_messages import REPLAY_CONTROL, ReplayRequest, ReplayStatus
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.recording.replay.replay import Replay

pytestmark = pytest.mark.slow

NS_PER_S = 1_000_000_000


class Stage:
    def __init__(self, run: Path) -> None:
        self.session = open_lockstep_session()
        self.clock = VirtualClock()
        self.ear = Endpoint(self.session, "replay", LiveClock(), Drive.LOCKSTEP)
        self.wire = Endpoint(self.session, "replay", self.clock, Drive.LOCKSTEP)
        self.inbox = Inbox(capacity=100_000, every=True)
        for topic in ShownTeam().topics:
            self.ear.subscribe(self.inbox, topic)
        self.replay = Replay(self.wire, run)
        self.terminal = ReplayTerminal(self.replay)

    def step(self, seconds: float) -> int:
        for _ in range(round(seconds * 10)):
            self.clock.advance_to(self.clock.now_ns() + NS_PER_S // 10)
            self.replay.step(self.clock.now_ns())
        return len(self.inbox)

    def view(self) -> ShownTeam:
        view = ShownTeam()
        for received in self.inbox.drain():
            view.apply(received, 0.0)
        return view

    def ask(self, request: ReplayRequest) -> ReplayStatus:
        return self.ear.ask(REPLAY_CONTROL, request)

    def close(self) -> None:
        self.replay.close()
        self.wire.close()
        self.ear.close()
        self.session.close()


@pytest.fixture
def stage(run: Path) -> Iterator[Stage]:
    stage = Stage(run)
    yield stage
    stage.close()


def test_a_query_pauses_moves_and_speeds_up_and_tells_where_it_is(stage: Stage) -> None:
    stage.step(0.2)
    status = stage.ask(ReplayRequest(playing=False, seek_s=5.0, speed=4.0))
    assert status == ReplayStatus(position_s=5.0, duration_s=stage.replay.player.duration_s, speed=4.0, playing=False)
    stage.inbox.drain()
    assert stage.step(1.0) == 0
    assert stage.ask(ReplayRequest(playing=True)).playing
    stage.step(1.1)
    assert stage.ask(ReplayRequest()).position_s == pytest.approx(9.0, abs=0.5)


def test_a_query_that_makes_no_sense_is_told_so_and_changes_nothing(stage: Stage) -> None:
    stage.step(0.5)
    for payload in (b'{"speed":0}', b'{"speed":-1}', b'{"seek_s":"x"}', b"not json"):
        with pytest.raises(CallError) as caught:
            stage.ear.ask(REPLAY_CONTROL, payload)
        assert caught.value.code is ErrorCode.BAD_ARGUMENTS
    assert stage.ask(ReplayRequest()).playing


@pytest.mark.parametrize(
    ("pressed", "position_s", "speed", "playing"),
    [
        (["space"], 1.0, 1.0, False),
        (["space", "space"], 1.0, 1.0, True),
        (["right"], 11.0, 1.0, True),
        (["right", "left", "left"], 0.0, 1.0, True),
        (["+", "+"], 1.0, 5.0, True),
        (["space", "-"], 1.0, 0.5, False),
        (["0"], 0.0, 1.0, True),
        (["x", "F13"], 1.0, 1.0, True),
    ],
)
def test_keys_do_what_they_say(
    stage: Stage, pressed: list[str], position_s: float, speed: float, playing: bool
) -> None:
    stage.replay.step(0)
    stage.replay.step(NS_PER_S)
    for key in pressed:
        stage.terminal.press(key)
    player = stage.replay.player
    assert (player.position_s, player.speed, player.playing) == (pytest.approx(position_s), speed, playing)
    assert not stage.terminal.ended
