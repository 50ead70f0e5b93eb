"""Lockstep does not depend on the wall clock: pauses of the process do not change a run."""

import functools
import random
import time
from collections import Counter

import pytest

from robrain import Scenario
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.robot_tasks import RobotTasks
from robrain.coordinator.coordinator import Coordinator
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.wire.endpoint import Endpoint

pytestmark = pytest.mark.slow

SECONDS = 5.0
LONG_S, SHORT_S = 0.7, 0.002
PAUSED = {
    RobotTasks: "offer",
    ManagedPlugin: "run_in_turn",
    Coordinator: "step",
    Exchange: "deliver",  # each message on its way to the inboxes
    Endpoint: "_reply",  # each handler of a query
}
"""Functions that pause at random, each with the share of calls that pause."""
SHARES = {"offer": 1.0, "run_in_turn": 0.02, "step": 0.2, "deliver": 0.02, "_reply": 0.5}


def digest() -> str:
    with Scenario.builtin("depot").replace(robots=2).team(seed=3) as team:
        team.submit("visit", id="look", place=(3.0, 8.0))
        team.run_for(SECONDS)
    assert team.transport.summary is not None
    return team.transport.summary.digest


def test_random_pauses_in_handlers_steps_and_deliveries_leave_the_digest_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wanted = digest()
    chance, paused = random.Random(), Counter[str]()

    def with_pauses(name: str, function):
        @functools.wraps(function)
        def paused_first(*arguments, **named):
            if chance.random() < SHARES[name]:
                paused[name] += 1
                time.sleep(LONG_S if name == "offer" and paused[name] == 1 else SHORT_S * chance.random())
            return function(*arguments, **named)

        return paused_first

    for owner, name in PAUSED.items():
        monkeypatch.setattr(owner, name, with_pauses(name, getattr(owner, name)))
    assert digest() == wanted
    assert min(paused[name] for name in PAUSED.values()) > 0
