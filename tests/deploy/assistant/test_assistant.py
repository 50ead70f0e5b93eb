"""An assistant at a team in lockstep: rehearsal, confirmation, refusal, log."""

import itertools
import json
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from robrain.client.team import Team
from robrain.deploy.assistant import team_reader
from robrain.deploy.assistant.arguments import ANSWER_MAX, CallVerdict, ToolAnswer, answer, harmless
from robrain.deploy.assistant.assistant import Assistant, Confirmations, ToolCall
from robrain.deploy.assistant.audit_log import AuditLog
from robrain.deploy.assistant.policy import OPEN_TASKS_MAX, AuditError, Ban, Order
from robrain.protocol.access.member import Member, MemberRole
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.lockstep.lockstep import LockstepTransport
from robrain.sim.scenarios.scenario import Scenario

VISIT = {"kind": "visit", "x_m": 2.0, "y_m": 1.0, "earliest_in_s": 3000.0}


class Desk:
    """An assistant, and what a test needs beside it."""

    def __init__(self, team: Team, folder: Path, member: Member | None = None) -> None:
        self.team = team
        self.log = AuditLog(folder / "log.jsonl")
        self.noted: list[str] = []
        self.now_s = 0.0
        tokens, ids = itertools.count(1), itertools.count(1)
        self.assistant = Assistant(
            team,
            team,
            member,
            self.log,
            Confirmations(lambda: self.now_s, lambda: f"token{next(tokens)}"),
            new_id=lambda: f"{folder.name[-8:]}{next(ids)}",
            now=lambda: datetime(2026, 1, 1, tzinfo=UTC),
            elapsed_s=lambda: self.now_s,
            warn=self.noted.append,
        )

    def call(self, tool: str, arguments: object, client: str = "scripted 1.0") -> ToolAnswer:
        return self.assistant.answer(ToolCall(client, tool, arguments))

    def lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.log.path.read_text().splitlines()]


@pytest.fixture(scope="module")
def team() -> Iterator[Team]:
    with Scenario.builtin("arena_small").replace(robots=2, motes=0).team(by="ben") as found:
        found.run_for(2.0)
        assert isinstance(found.transport, LockstepTransport)
        assistants = Team(LockstepTransport(found.transport.run), by="assistant:ann")
        found.run_for(1.0)  # it has heard states
        yield assistants


@pytest.fixture
def open_desk(team: Team, tmp_path: Path) -> Iterator[Callable[..., Desk]]:
    opened: list[Desk] = []

    def open_one(member: Member | None = None) -> Desk:
        opened.append(Desk(team, tmp_path, member))
        return opened[-1]

    yield open_one
    for desk in opened:
        desk.log.close()


@pytest.fixture
def desk(open_desk: Callable[..., Desk]) -> Desk:
    return open_desk()


def test_an_order_is_carried_out_only_once_it_is_confirmed(desk: Desk, team: Team) -> None:
    before = len(team.list())
    rehearsed = desk.call("submit_task", VISIT)
    assert rehearsed.verdict is CallVerdict.REHEARSED
    assert len(team.list()) == before
    done = desk.call("submit_task", {**VISIT, "confirm": rehearsed.values["confirm"]})
    assert done.verdict is CallVerdict.DONE
    record = team.get(rehearsed.values["task"])
    assert (record.state, record.by, record.task.priority) == (TaskState.QUEUED, "assistant:ann", 1.0)
    assert len(team.list()) == before + 1
    asked = {"task": record.task.id}
    token = desk.call("cancel_task", asked).values["confirm"]
    assert team.get(record).state is TaskState.QUEUED
    assert desk.call("cancel_task", {**asked, "confirm": token}).verdict is CallVerdict.DONE
    assert team.get(record).state is TaskState.CANCELLED


def test_a_token_confirms_no_other_tool_argument_or_client(desk: Desk, team: Team) -> None:
    before = len(team.list())
    for tool, changed, client in (
        ("submit_task", {"x_m": 2.5}, "scripted 1.0"),
        ("submit_task", {"parameters": {"a": 1}}, "scripted 1.0"),
        ("submit_task", {}, "another 1.0"),
    ):
        token = desk.call("submit_task", VISIT).values["confirm"]
        found = desk.call(tool, {**VISIT, **changed, "confirm": token}, client)
        assert found.code == Ban.ANOTHER_ORDER
        assert desk.call("submit_task", {**VISIT, "confirm": token}).code == Ban.NO_TOKEN
    token = desk.call("submit_task", VISIT).values["confirm"]
    assert desk.call("cancel_task", {"task": "t", "confirm": token}).code == Ban.ANOTHER_ORDER
    token = desk.call("submit_task", VISIT).values["confirm"]
    desk.now_s += 121.0
    assert desk.call("submit_task", {**VISIT, "confirm": token}).code == Ban.EXPIRED
    assert len(team.list()) == before


def test_every_call_is_logged_and_a_confirmed_order_before_it_is_carried_out(desk: Desk) -> None:
    token = desk.call("submit_task", VISIT).values["confirm"]
    desk.call("submit_task", {**VISIT, "confirm": token})
    desk.call("resume", {})
    desk.call("robot_state", {"robot": "*"})
    assert [(line["call"], line["tool"], line["verdict"], line["code"]) for line in desk.lines()] == [
        (1, "submit_task", "rehearsed", ""),
        (2, "submit_task", "begun", ""),
        (2, "submit_task", "done", ""),
        (3, "resume", "refused", "resume"),
        (4, "robot_state", "refused", "bad_arguments"),
    ]
    assert {(line["by"], line["client"]) for line in desk.lines()} == {("assistant:ann", "scripted 1.0")}
    assert json.loads(desk.lines()[0]["arguments"]) == VISIT


def test_an_order_that_cannot_be_logged_is_not_carried_out_but_a_halt_is(
    desk: Desk, team: Team, monkeypatch: pytest.MonkeyPatch
) -> None:
    token = desk.call("submit_task", VISIT).values["confirm"]
    before = len(team.list())

    def full(_record: object) -> None:
        raise AuditError(desk.log.path, OSError(28, "No space left on device"))

    monkeypatch.setattr(desk.log, "write", full)
    refused = desk.call("submit_task", {**VISIT, "confirm": token})
    assert (refused.verdict, refused.code) == (CallVerdict.REFUSED, Ban.NOT_LOGGED)
    assert "No space left" in refused.words
    assert len(team.list()) == before
    assert desk.call("halt", {"reason": "smoke"}).verdict is CallVerdict.DONE
    assert team.state("r1").halted
    assert len(desk.noted) == 2
    team.resume()
    team.run_for(1.0)
    assert not team.state("r1").halted


def test_a_viewers_assistant_looks_and_gives_no_order(open_desk: Callable[..., Desk], team: Team) -> None:
    desk = open_desk(Member(MemberRole.VIEWER, "default", "vic"))
    assert desk.call("list_robots", {}).verdict is CallVerdict.READ
    assert desk.call("dry_run", VISIT).verdict is CallVerdict.READ
    for order, arguments in (
        (Order.SUBMIT, VISIT),
        (Order.CANCEL, {"task": "t"}),
        (Order.CALL, {"robot": "r1", "plugin": "counter", "function": "seconds"}),
        (Order.HALT, {}),
    ):
        found = desk.call(order, arguments)
        assert (found.verdict, found.code) == (CallVerdict.REFUSED, Ban.ROLE)
        assert "viewer:vic" in found.words
        assert not desk.assistant.may(order)
    assert not team.state("r1").halted


def test_an_assistant_has_a_bounded_number_of_open_tasks(desk: Desk, team: Team) -> None:
    is_open = sum(not record.state.ended for record in team.list())
    early = desk.call("submit_task", VISIT).values["confirm"]
    for number in range(OPEN_TASKS_MAX - is_open):
        assert desk.call("submit_task", VISIT).verdict is CallVerdict.REHEARSED
        team.submit("visit", id=f"filling-{number}", place=(2.0, 1.0), earliest_s=3000.0)
    assert desk.call("submit_task", VISIT).code == Ban.TOO_MANY_TASKS
    assert (
        desk.call("submit_task", {**VISIT, "confirm": early}).code == Ban.TOO_MANY_TASKS
    )  # rehearsed when there was room
    for record in team.list():
        if not record.state.ended:
            team.cancel(record)
    assert desk.call("submit_task", VISIT).verdict is CallVerdict.REHEARSED


def test_what_the_team_would_refuse_gets_no_token(desk: Desk) -> None:
    for arguments in ({**VISIT, "needs": ["arm"]}, {**VISIT, "x_m": 5000.0}, {**VISIT, "parameters": {"hop": 1}}):
        found = desk.call("submit_task", arguments)
        assert found.verdict is CallVerdict.REFUSED
        assert "confirm" not in found.values
    assert desk.call("dry_run", {**VISIT, "needs": ["arm"]}).verdict is CallVerdict.REFUSED


def test_a_call_is_rehearsed_with_its_signature_and_carried_out_with_its_arguments(desk: Desk) -> None:
    asked = {"robot": "r1", "plugin": "energy", "function": "estimate", "arguments": {"work": {"path_m": 10.0}}}
    rehearsed = desk.call("call_plugin", asked)
    assert rehearsed.verdict is CallVerdict.REHEARSED
    assert "estimate(work: Work)" in rehearsed.words
    done = desk.call("call_plugin", {**asked, "confirm": rehearsed.values["confirm"]})
    assert done.values["result"]["mean_j"] > 0
    wrong = desk.call("call_plugin", {**asked, "arguments": {"work": {"path_m": "far"}}})
    assert wrong.code == Ban.BAD_ARGUMENTS
    assert "work.path_m" in wrong.words


def test_an_order_whose_answer_is_lost_is_said_to_be_unsure(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = {"robot": "r1", "plugin": "counter", "function": "seconds"}
    token = desk.call("call_plugin", asked).values["confirm"]

    def late(*_: object, **__: object) -> None:
        raise CallError(ErrorCode.TIMEOUT, "r1 did not answer in time")

    monkeypatch.setattr(desk.team, "call", late)
    found = desk.call("call_plugin", {**asked, "confirm": token})
    assert found.verdict is CallVerdict.FAILED
    assert "it may have been done" in found.words


def test_a_look_that_is_not_answered_is_refused_and_not_called_unsure(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    def late() -> None:
        raise CallError(ErrorCode.TIMEOUT, "no answer in time")

    monkeypatch.setattr(desk.team, "kinds", late)
    found = desk.call("list_kinds", {})
    assert (found.verdict, found.code) == (CallVerdict.REFUSED, Ban.TEAM)
    found = desk.call("dry_run", {**VISIT, "kind": "relay"})
    assert (found.verdict, found.code) == (CallVerdict.REFUSED, Ban.BAD_ARGUMENTS)


@pytest.mark.parametrize(
    "arguments",
    [{}, None, [], {"robot": "r1 and r2"}, {"robot": 7, "reason": "x" * 10_000}, {"reason": "a\nline"}, {"now": True}],
)
def test_a_halt_is_carried_out_whatever_its_arguments_are(desk: Desk, team: Team, arguments: object) -> None:
    found = desk.call("halt", arguments)
    assert found.verdict is CallVerdict.DONE
    assert found.values["confirmed"] == ["r1", "r2"]
    team.resume()


def test_a_halt_waits_neither_for_other_calls_nor_for_the_log(
    desk: Desk, team: Team, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[bool] = []
    monkeypatch.setattr(desk.log, "write", lambda _: written.append(team.state("r1").halted))
    with desk.assistant._lock:  # held by a call that takes long
        assert desk.call("halt", {"robot": "r1"}).verdict is CallVerdict.DONE
    assert written == [True]
    team.resume()


def test_a_mistake_in_the_code_is_logged_before_it_is_raised(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> None:
        raise ZeroDivisionError("oops")

    monkeypatch.setattr(desk.team, "kinds", broken)
    with pytest.raises(ZeroDivisionError):
        desk.call("list_kinds", {})
    assert desk.lines()[-1]["verdict"] == "failed"


def test_a_map_is_drawn_of_what_has_come_when_the_time_is_over(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(team_reader, "MAP_BUDGET_S", -1.0)
    found = desk.call("show_map", {})
    assert found.png.startswith(b"\x89PNG")
    assert "r1 does not send its map" in found.words
    assert "r1 at (" not in found.words


def test_text_of_the_team_is_cut_and_cannot_steer_a_terminal() -> None:
    found = answer(CallVerdict.READ, ["red \x1b[31m", "x" * 100_000], {"why": "a\u202eb", "many": ["y" * 300] * 10_000})
    assert "\x1b" not in found.words
    assert len(found.words) == ANSWER_MAX
    assert found.values == {"why": "a\\u202eb", "verdict": "looked"}
    deep: Any = []
    for _ in range(100):
        deep = [deep]
    assert json.dumps(harmless(deep)).count("[") < 10
