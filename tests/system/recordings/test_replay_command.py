"""`robrain replay`: what was recorded is on the wire again."""

import pytest

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE
from tests.system.conftest import member_at
from tests.waiting import until

pytestmark = pytest.mark.system


def test_replayed_states_are_heard_by_another_process(commands) -> None:
    assert commands.run("run", "arena_small", "--time-limit", "5", "--record", "run.mcap").returncode == 0
    process = commands.start("replay", "run.mcap", "--no-dashboard", "--loop", "--speed", "2")
    endpoint = commands.line_with(process, " at tcp/").rsplit(" at ", 1)[1].strip()
    with member_at(endpoint, "replay") as wire:
        inbox, presence = Inbox(), wire.watch(ROBOT_ALIVE)
        wire.subscribe(inbox, ROBOT_STATE)
        heard: set[str] = set()

        def hears_both() -> bool:
            heard.update(received.message.robot for received in inbox.drain())
            return heard == {"r1", "r2"}

        def sees_both() -> bool:
            presence.changes()
            return sorted(names["robot"] for names in presence.present.values()) == ["r1", "r2"]

        until(hears_both, "their states were never heard")
        until(sees_both, "their tokens were never seen")
