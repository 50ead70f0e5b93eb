"""An assistant at a team in lockstep: rehearsal, confirmation, refusal, log, map."""

import io
import itertools
import json
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from PIL import Image

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.client.team import Team
from robrain.deploy.assistant import assistant, audit_log
from robrain.deploy.assistant.arguments import CallVerdict, ToolAnswer
from robrain.deploy.assistant.assistant import Assistant, Confirmations, ToolCall
from robrain.deploy.assistant.audit_log import AuditLog, AuditRecord
from robrain.deploy.assistant.policy import OPEN_TASKS_MAX, AuditError, Ban, Order
from robrain.deploy.assistant.team_reader import MARGIN_M, SIDE_PX, map_png
from robrain.protocol.access.member import Member, MemberRole
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model import grid_geometry
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.drawing.drawn_map import ComposedMap
from robrain.recording.drawing.palette import FREE, OCCUPIED, UNKNOWN
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
        (3, "resume", "refused", "unknown_tool"),
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


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def orders(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Confirmations:
    numbers = itertools.count(1)
    monkeypatch.setattr(assistant, "LIFE_S", 10.0)
    monkeypatch.setattr(assistant, "CAPACITY", 3)
    return Confirmations(clock, lambda: f"token-{next(numbers)}")


@pytest.mark.parametrize(("who", "order"), [("scripted", b"another"), ("another", b"order"), ("", b"")])
def test_a_token_is_void_after_it_was_given_for_another_order_or_by_another_client(
    orders: Confirmations, who: str, order: bytes
) -> None:
    token = orders.keep("scripted", b"order", "plan")
    assert orders.redeem(token, who, order) is Ban.ANOTHER_ORDER
    assert orders.redeem(token, "scripted", b"order") is Ban.NO_TOKEN


def test_a_token_expires(orders: Confirmations, clock: Clock) -> None:
    early, late = orders.keep("scripted", b"1", "early"), orders.keep("scripted", b"2", "late")
    clock.now_s = 9.9
    assert orders.redeem(early, "scripted", b"1") == "early"
    clock.now_s = 10.0
    assert orders.redeem(late, "scripted", b"2") is Ban.EXPIRED


def test_of_too_many_orders_the_oldest_is_dropped_and_counted(orders: Confirmations) -> None:
    tokens = [orders.keep("scripted", b"order", f"plan-{number}") for number in range(5)]
    assert (len(orders), orders.dropped) == (3, 2)
    assert orders.redeem(tokens[1], "scripted", b"order") is Ban.NO_TOKEN
    assert orders.redeem(tokens[2], "scripted", b"order") == "plan-2"


RECORD = AuditRecord(
    stamp="2026-01-01T00:00:00.000+00:00", call=1, by="assistant:ann", client="scripted 1.0", tool="halt",
    arguments="{}", verdict="done",
)  # fmt: skip


def numbers(path: Path) -> list[int]:
    return [json.loads(line)["call"] for line in path.read_text().splitlines()]


def test_a_full_file_is_followed_by_the_next_and_the_oldest_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(audit_log, "FILE_BYTES", 2 * (len(msgspec.json.encode(RECORD)) + 1))
    monkeypatch.setattr(audit_log, "FILES", 3)
    log = AuditLog(tmp_path / "log.jsonl")
    for call in range(1, 10):
        log.write(msgspec.structs.replace(RECORD, call=call))
    log.close()
    assert numbers(tmp_path / "log.jsonl") == [9]
    assert numbers(tmp_path / "log.jsonl.1") == [7, 8]
    assert numbers(tmp_path / "log.jsonl.2") == [5, 6]
    assert len(list(tmp_path.iterdir())) == 3


def test_a_log_that_could_not_be_written_is_opened_again_for_the_next_record(tmp_path: Path) -> None:
    log = AuditLog(tmp_path / "log.jsonl")
    log.close()
    log.path.unlink()
    log.path.mkdir()
    with pytest.raises(AuditError):
        log.write(RECORD)
    log.path.rmdir()
    log.write(RECORD)
    log.close()
    assert numbers(log.path) == [1]


WIDTH_M, HEIGHT_M = 12.0, 6.0
ORIGIN = (-20.0, -10.0)


@pytest.fixture(scope="module")
def floor() -> ComposedMap:
    """A free room from (0, 0) to (12, 6) with a wall one metre thick on the right, on a larger grid."""
    classes = np.full((60, 120), grid_geometry.FREE, np.int8)
    classes[:, 110:] = grid_geometry.OCCUPIED
    view = ComposedMap()
    geometry = GridGeometry(0.1, *ORIGIN, 400, 300)
    view.merge(to_message("r1", geometry, PatchCells(100, 200, classes, 1000)))
    return view


def pixel(png: bytes, x_m: float, y_m: float, bounds: tuple[float, float, float, float]) -> tuple[int, ...]:
    """The colour at a place of the arena, for a map with these bounds."""
    with Image.open(io.BytesIO(png)) as image:
        px_per_m = image.width / (bounds[2] - bounds[0] + 2 * MARGIN_M)
        at = int((x_m - bounds[0] + MARGIN_M) * px_per_m), int((bounds[3] + MARGIN_M - y_m) * px_per_m)
        found = image.convert("RGB").getpixel(at)
    assert isinstance(found, tuple)
    return found


def test_floor_walls_and_unknown_lie_where_they_are_in_the_arena(floor: ComposedMap) -> None:
    bounds = floor.known_bounds_m()
    assert bounds == pytest.approx((0.0, 0.0, WIDTH_M, HEIGHT_M))
    png = map_png(floor, [], [])
    assert pixel(png, 0.53, 0.53, bounds) == FREE
    assert pixel(png, 10.53, 5.53, bounds) == FREE
    assert pixel(png, 11.53, 0.53, bounds) == OCCUPIED
    assert pixel(png, -0.53, 3.53, bounds) == UNKNOWN
    assert pixel(png, 12.53, 3.53, bounds) == UNKNOWN
    with Image.open(io.BytesIO(png)) as image:
        assert max(image.size) == pytest.approx(min(SIDE_PX, 60 * (WIDTH_M + 2 * MARGIN_M)), abs=1)
