"""Messages of the project's own components stay within the ranges of their types: none is rejected in a run."""

import pytest

from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.table.topics import all_topics
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.scenarios.scenario import Scenario

pytestmark = pytest.mark.slow

RUN_S = 20.0


def test_every_message_of_a_run_is_accepted() -> None:
    run = LockstepRun(Scenario.builtin("arena_small").replace(robots=3, motes=4, seed=5).world())
    ears = Endpoint(run.session, "default", run.clock, Drive.LOCKSTEP)
    inbox = Inbox(100_000, every=True)
    for topic in all_topics():
        if topic.message is not None:
            ears.subscribe(inbox, topic)
    heard = set()
    try:
        while run.clock.now_ns() < to_ns(RUN_S):
            run.tick()
            heard |= {received.topic.name for received in inbox.drain()}
    finally:
        ears.close()
        run.close()
    assert ears.refusals.counts() == []
    assert {"robot_state", "robot_map", "robot_path", "coordinator_state", "task_event", "mote_reading"} <= heard
