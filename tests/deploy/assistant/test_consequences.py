"""Two hundred orders, sixty of them harmful: the harm is named before anything is done."""

import itertools
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from robrain.client.team import Team
from robrain.deploy.assistant.arguments import CallVerdict, ToolAnswer
from robrain.deploy.assistant.assistant import Assistant, Confirmations, ToolCall
from robrain.deploy.assistant.audit_log import AuditLog
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.lockstep.lockstep import LockstepTransport
from robrain.sim.scenarios.scenario import Scenario

ROOMS = """
[scenario]
name = "two rooms"
[floor]
size_m = [10.0, 5.0]
walls = [{ from_m = [5.0, 0.0], to_m = [5.0, 2.0] }, { from_m = [5.0, 3.0], to_m = [5.0, 5.0] }]
[team]
robots = 2
near_m = [2.5, 2.5]
[robot.battery]
soc_at_start = 0.35
"""
DOOR = (5.0, 2.5)
HARMFUL, HARMLESS = 15, 140
"""Harmful orders of each kind, and the others."""


@pytest.fixture(scope="module")
def ben() -> Iterator[Team]:
    """A person's connection; the floor is known, and his tasks wait on both sides of the door."""
    with Scenario.from_toml(ROOMS).team(by="ben") as team:
        team.run_for(60.0)
        for number in range(3):
            team.submit("visit", place=(7.5, 1.0 + number), id=f"far-{number}", earliest_s=400.0)
            team.submit("visit", place=(1.5 + 0.5 * number, 3.5), id=f"near-{number}", earliest_s=400.0)
        team.run_for(1.0)
        yield team


@pytest.fixture
def assistant(ben: Team, tmp_path: Path) -> Iterator[Assistant]:
    assert isinstance(ben.transport, LockstepTransport)
    team, tokens, ids = (
        Team(LockstepTransport(ben.transport.run), by="assistant:ann"),
        itertools.count(),
        itertools.count(),
    )
    log = AuditLog(tmp_path / "log.jsonl")
    yield Assistant(
        team, team, None, log, Confirmations(lambda: 0.0, lambda: f"token{next(tokens)}"),
        new_id=lambda: f"{next(ids)}", now=lambda: datetime(2026, 1, 1, tzinfo=UTC),
        elapsed_s=lambda: 0.0, warn=lambda _: None,
    )  # fmt: skip
    log.close()


@pytest.mark.slow
def test_no_harmful_order_is_carried_out_before_its_consequence_is_named(ben: Team, assistant: Assistant) -> None:
    rng = np.random.default_rng(40)

    def rehearse(tool: str, **arguments: object) -> ToolAnswer:
        before = {one.task.id: one.state for one in ben.list()}
        found = assistant.answer(ToolCall("scripted 1.0", tool, arguments))
        assert {one.task.id: one.state for one in ben.list()} == before
        assert found.verdict is CallVerdict.REHEARSED, found
        return found

    def visit(x_m: float, y_m: float, service_s: float = 0.0) -> ToolAnswer:
        return rehearse("submit_task", kind="visit", x_m=x_m, y_m=y_m, service_s=service_s)

    for _ in range(HARMFUL):
        blocking = visit(*DOOR, service_s=float(rng.uniform(20.0, 60.0)))
        assert any(name in blocking.words for name in ("far-0", "near-0", "charger")), blocking.words
        assert blocking.values["blocks"]
    for _ in range(HARMFUL):
        starving = visit(float(rng.uniform(1.0, 4.0)), float(rng.uniform(1.0, 4.0)), float(rng.uniform(100.0, 300.0)))
        late = {one["task"] for one in starving.values["delays"]}
        assert late, starving.words
        assert all(name in starving.words for name in late)
    for _ in range(HARMFUL):
        stranding = visit(
            float(rng.uniform(6.0, 9.0)), float(rng.uniform(1.0, 4.0)), float(rng.uniform(3000.0, 3600.0))
        )
        assert stranding.values["estimate"] is None
        assert "reserve" in stranding.words or "lacks" in stranding.words, stranding.words
    for number in range(HARMFUL):
        first = visit(2.0, 2.0)
        token = {"confirm": first.values["confirm"]}
        order = {"kind": "visit", "x_m": 2.0, "y_m": 2.0, "service_s": 0.0}
        done = assistant.answer(ToolCall("scripted 1.0", "submit_task", {**order, **token}))
        assert done.verdict is CallVerdict.DONE
        name = str(first.values["task"])
        ben.submit("visit", place=(3.0, 1.0), id=f"then-{number}", after=[name], earliest_s=400.0)
        cancelling = rehearse("cancel_task", task=name)
        assert f"then-{number}" in cancelling.words
        assert ben.get(name).state is not TaskState.CANCELLED
        ben.cancel(f"then-{number}")
        ben.cancel(name)
    for _ in range(HARMLESS):
        plain = visit(float(rng.uniform(1.0, 4.0)), float(rng.uniform(1.0, 4.0)))
        assert plain.values["estimate"] is not None, plain.words
        assert not plain.values["blocks"]
