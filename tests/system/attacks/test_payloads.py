"""Attacks by members through robrain's own keys: other names in messages, too much, nonsense, floods."""

from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from robrain.client.team import Team
from robrain.client.transport import LiveTransport
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HOST_HOLD, HOST_LOAD, HOST_RELEASE, HOST_RESUME
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_PLUGINS
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.task_messages import TASK_CANCEL, TASK_GET, TASK_SUBMIT, TaskRequest, TaskState
from robrain.protocol.topic import Query
from robrain.protocol.wire.endpoint import Endpoint
from tests.system.attacks.secured_team import TEAM, SecuredTeam, member_named, soon
from tests.waiting import until

pytestmark = pytest.mark.system
T = "robrain/blue"
TASK = b'{"task": {"id": "%s", "kind": "tool", "place": {"x_m": 1, "y_m": 1}}, "by": "%s"}'


@pytest.fixture(scope="module")
def ann(team: SecuredTeam) -> Endpoint:
    return team.wire("operator ann")


@pytest.fixture(scope="module")
def states(ann: Endpoint) -> Callable[[], RobotState]:
    inbox = Inbox()
    ann.subscribe(inbox, ROBOT_STATE, robot="r1")
    return lambda: until(inbox.drain, "r1 is silent")[-1].message


def _errors(team: SecuredTeam, name: str, key: str, payload: bytes) -> list[str]:
    """The codes of the errors that a raw question is answered with; no answer at all is none."""
    replies = team.session(member_named(name)).get(key, payload=payload, timeout=2.0)
    return ["" if reply.err is None else msgspec.json.decode(reply.err.payload.to_bytes())["code"] for reply in replies]


@pytest.mark.parametrize("by", ["operator:bob", "robot:ann"])
@pytest.mark.parametrize(
    ("key", "rest"),
    [
        ("robot/r1/host/halt", b'"reason": ""'),
        ("robot/r1/host/hold", b'"plugin": "tool"'),
        ("robot/r1/host/resume", b'"more": 1'),
        ("task/cancel", b'"id": "none"'),
        ("coordinator/objective", b'"objective": "energy"'),
    ],
)
def test_order_in_another_name_is_forbidden(team: SecuredTeam, by: str, key: str, rest: bytes) -> None:
    payload = b'{"by": "%s", %s}' % (by.encode(), rest)
    assert _errors(team, "operator ann", f"{T}/as/operator/ann/{key}", payload) == [ErrorCode.FORBIDDEN]


@pytest.mark.parametrize("by", ["operator:ann", "hall2"])
def test_halt_in_another_name_stops_nobody(team: SecuredTeam, states: Callable[[], RobotState], by: str) -> None:
    session = team.session(member_named("dashboard hall"))
    session.put(f"{T}/as/dashboard/hall/halt", b'{"stamp_ns": 1, "seq": 0, "halted": true, "by": "%s"}' % by.encode())
    assert not soon(lambda: states().halted)
    assert _refused(states, "as/dashboard/hall/halt", "wrong_name")


def _refused(states: Callable[[], RobotState], key: str, code: str) -> bool:
    """Whether the robot tells what it has refused, and from whom."""

    def is_told() -> bool:
        refused = states().refused
        return isinstance(refused, list) and any(one.key.endswith(key) and one.code == code for one in refused)

    return until(is_told, f"r1 does not say that it refused {key} as {code}")


@pytest.mark.parametrize(
    ("payload", "code"),
    [
        pytest.param(b"x" * 5000, "too_large", id="large"),
        pytest.param(b"[" * 2000, "malformed", id="deep"),
        pytest.param(b"\xff\xfe", "malformed", id="no text"),
        pytest.param(b'{"halted": "yes"}', "malformed", id="other type"),
        pytest.param(b"", "malformed", id="empty"),
    ],
)
def test_halt_that_is_none_stops_nobody(
    team: SecuredTeam, states: Callable[[], RobotState], payload: bytes, code: str
) -> None:
    team.session(member_named("operator bob")).put(f"{T}/as/operator/bob/halt", payload)
    assert _refused(states, "as/operator/bob/halt", code)
    assert not states().halted


@pytest.mark.parametrize("payload", [b"x" * 2_000_000, b"[" * 5000, b"\xff", b"[]", b'{"task": 1}', b"<script>"])
@pytest.mark.parametrize("key", ["task/submit", "robot/r1/host/load"])
def test_order_that_is_none_is_refused_in_words(team: SecuredTeam, key: str, payload: bytes) -> None:
    assert _errors(team, "operator bob", f"{T}/as/operator/bob/{key}", payload) == [ErrorCode.BAD_ARGUMENTS]


def test_dashboard_cancels_its_own_tasks_alone(team: SecuredTeam, ann: Endpoint) -> None:
    hall = team.wire("dashboard hall")
    for wire, name in ((ann, "anns"), (hall, "halls"), (hall, "halls-2")):
        asked = msgspec.json.decode(TASK % (name.encode(), b""), type=TASK_SUBMIT.request)
        record = wire.ask(TASK_SUBMIT, asked)
        assert record.by == str(wire.member)
    with pytest.raises(CallError, match="is no operator") as caught:
        hall.ask(TASK_CANCEL, TaskRequest(id="anns"))
    assert caught.value.code is ErrorCode.FORBIDDEN
    assert hall.ask(TASK_CANCEL, TaskRequest(id="halls")).state is TaskState.CANCELLED
    assert ann.ask(TASK_GET, TaskRequest(id="anns")).state is not TaskState.CANCELLED
    for name in ("anns", "halls-2"):
        assert ann.ask(TASK_CANCEL, TaskRequest(id=name)).state is TaskState.CANCELLED


def test_dashboard_halts_the_team_and_an_operator_alone_resumes_it(
    team: SecuredTeam, states: Callable[[], RobotState], monkeypatch: pytest.MonkeyPatch
) -> None:
    def client(name: str) -> Team:
        for variable, value in team.variables(name).items():
            monkeypatch.setenv(variable, value)
        return Team(LiveTransport(team=TEAM), by="operator:somebody")

    with client("operator bob") as bob, client("dashboard hall") as hall, client("viewer vic") as vic:
        with pytest.raises(CallError, match="viewer:vic may not publish halt: dashboard, operator may"):
            vic.halt()
        assert bob.halt().confirmed == ("r1",)
        assert states().halted_by == ["operator:bob"]
        assert list(hall.resume().unconfirmed) == ["r1"]
        assert until(lambda: states().halted)
        assert bob.resume().confirmed == ("r1",)
        until(lambda: not states().halted)


def test_plugin_is_held_in_the_name_of_the_certificate(team: SecuredTeam, ann: Endpoint) -> None:
    bob = team.wire("operator bob")
    hold = HOST_HOLD.request(plugin="tool", by="ann")
    assert ann.ask(HOST_HOLD, hold, robot="r1").holder == "operator:ann"
    with pytest.raises(CallError, match="operator:ann") as caught:  # he says that he is ann, and is not believed
        bob.ask(HOST_HOLD, hold, robot="r1")
    assert caught.value.code is ErrorCode.BUSY
    with pytest.raises(CallError, match="operator:ann"):
        bob.ask(ROBOT_CALL, robot="r1", plugin="tool", function="read")
    assert ann.ask(ROBOT_CALL, robot="r1", plugin="tool", function="read") is not None
    assert not bob.ask(HOST_RELEASE, HOST_RELEASE.request(plugin="tool", by="ann"), robot="r1")
    assert ann.ask(HOST_RELEASE, HOST_RELEASE.request(plugin="tool", by="ann"), robot="r1")


@pytest.mark.parametrize("name", ["viewer vic", "robot r2"])
@pytest.mark.parametrize(
    ("query", "request_"),
    [
        (HOST_LOAD, HOST_LOAD.request(plugin="counter")),
        (HOST_RESUME, HOST_RESUME.request()),
        (HOST_RELEASE, HOST_RELEASE.request(plugin="tool", by="x")),
    ],
    ids=["load", "resume", "release"],
)
def test_who_may_not_is_told_so_before_anything_is_sent(
    team: SecuredTeam, name: str, query: Query[Any, Any], request_: Any
) -> None:
    with pytest.raises(CallError, match=r"may not ask host_\w+: operator may") as caught:
        team.wire(name).ask(query, request_, robot="r1")
    assert caught.value.code is ErrorCode.FORBIDDEN


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "/etc/passwd", "counter/../counter", "\x1b[2Jcounter", "<b>x</b>"]
)
def test_operator_loads_nothing_by_a_path_that_is_not_open(team: SecuredTeam, ann: Endpoint, name: str) -> None:
    with pytest.raises(CallError):
        ann.ask(HOST_LOAD, HOST_LOAD.request(plugin=name), robot="r1")


def test_flood_of_questions_keeps_nobody_from_a_robot(team: SecuredTeam, ann: Endpoint) -> None:
    session = team.session(member_named("viewer vic"))
    waiting = [session.get(f"{T}/robot/r1/plugins", timeout=5.0) for _ in range(500)]

    def is_answered() -> bool:
        """A robot refuses in words while as many questions wait as it keeps, and is asked again."""
        try:
            plugins = ann.ask(ROBOT_PLUGINS, robot="r1")
            return bool(plugins) and ann.ask(ROBOT_CALL, robot="r1", plugin="tool", function="read") is not None
        except CallError:
            return False

    until(is_answered)
    assert all(list(replies) for replies in waiting)
