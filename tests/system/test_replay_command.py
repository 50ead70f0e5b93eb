"""`robrain replay`: what was recorded is on the wire again."""

import time

import pytest

from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.session import open_session
from robrain.protocol.wire.topics import ROBOT_ALIVE, ROBOT_STATE
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system


def test_replayed_states_are_heard_by_another_process(commands) -> None:
    assert commands.run("run", "arena_small", "--time-limit", "5", "--record", "run.mcap").returncode == 0
    process = commands.start("replay", "run.mcap", "--no-dashboard", "--loop", "--speed", "2")
    endpoint = commands.line_with(process, " at tcp/").rsplit(" at ", 1)[1].strip()
    session = open_session(connect=[endpoint])
    wire = Endpoint(session, "replay", WallClock(), Drive.LIVE)
    try:
        inbox, presence = Inbox(), wire.watch(ROBOT_ALIVE)
        wire.subscribe(inbox, ROBOT_STATE)
        heard: set[str] = set()
        deadline_s = time.monotonic() + PATIENCE_S
        while heard != {"r1", "r2"} and time.monotonic() < deadline_s:
            heard |= {received.message.robot for received in inbox.drain()}
            time.sleep(0.05)
        assert heard == {"r1", "r2"}
        presence.changes()
        assert sorted(names["robot"] for names in presence.present.values()) == ["r1", "r2"]
    finally:
        wire.close()
        session.close()
