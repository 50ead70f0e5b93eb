"""A secured team on two hosts, each with a router of its own; the link between the routers is cut and heals."""

import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime

import pytest

from robrain.deploy.pki.folder import folder_of
from robrain.deploy.pki.issuing import init, issue
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.access.identity import TLS_VARIABLE, read_identity
from robrain.protocol.wire.access.member import Member, member
from robrain.protocol.wire.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.tasks.task_messages import TaskFilter, TaskSubmission
from robrain.protocol.wire.session import open_session
from robrain.protocol.wire.topics import COORDINATOR_STATE, TASK_EVENT, TASK_LIST, TASK_SUBMIT
from tests.asking import until_answered
from tests.system.conftest import Commands
from tests.system.relayed_network import FAR, RelayedNetwork, relayed_network
from tests.system.routers import start_router
from tests.waiting import until

pytestmark = pytest.mark.system
TEAM = "blue"
SITE, HALL = member("router", TEAM, "site"), member("router", TEAM, "hall")
HQ, ANN = member("coordinator", TEAM, "hq"), member("operator", TEAM, "ann")
SIM, ROBOT = member("arena", TEAM, "sim"), member("robot", TEAM, "r1")
HALL_AT = f"tls/{FAR}:7473"
NOTICED_S, BACK_S = 2.0, 6.0
"""Measured beside other work: 0.82 s until absence is noticed, 1.7 s until the robot is back."""
ROOM = '[scenario]\nname = "room"\n[floor]\nsize_m = [10.0, 6.0]\n[team]\nrobots = 1\n'


class SecuredHosts:
    """Robot and arena behind a router on the far host; coordinator and operator behind one here."""

    def __init__(self, commands: Commands, network: RelayedNetwork) -> None:
        self.commands, self.network = commands, network
        self.pki = commands.folder / "pki"
        init(self.pki, TEAM, datetime.now(UTC))
        for who in (SITE, HQ, ANN, SIM, ROBOT):
            issue(self.pki, who, datetime.now(UTC))
        issue(self.pki, HALL, datetime.now(UTC), hosts=[FAR])
        (commands.folder / "room.toml").write_text(ROOM)
        router = self._far(HALL, "router", "--listen", HALL_AT)
        commands.line_with(router, "members may connect")
        at = ("--team", TEAM, "--connect", HALL_AT)
        arena = self._far(SIM, "arena", "room.toml", *at, "--robot-files", "robots")
        commands.line_with(arena, "arena: room at")
        agent = self._far(ROBOT, "agent", "robots/r1.toml", "--connect", HALL_AT)
        site = start_router(commands, self.pki, SITE, connect=[HALL_AT])
        tls = {TLS_VARIABLE: str(folder_of(self.pki, HQ))}
        coordinator = commands.start("coordinator", "--team", TEAM, "--connect", site.endpoint, **tls)
        commands.line_with(coordinator, "of team")
        commands.line_with(agent, "agent: r1 is up")
        self.processes = (router, arena, agent, site.process, coordinator)
        session = open_session(connect=[site.endpoint], identity=read_identity(folder_of(self.pki, ANN)))
        self.wire = Endpoint(session, TEAM, LiveClock(), Drive.LIVE)
        self._summaries, self._events = Inbox(every=True), Inbox(capacity=65536, every=True)
        self.wire.subscribe(self._summaries, COORDINATOR_STATE)
        self.wire.subscribe(self._events, TASK_EVENT)
        self._is_up = False

    def _far(self, who: Member, *words: str) -> "subprocess.Popen[str]":
        tls = ("--tls", str(folder_of(self.pki, who)))
        command = self.network.words([sys.executable, "-m", "robrain.cli", *tls, *words])
        process = subprocess.Popen(
            command, cwd=self.commands.folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.commands.adopt(process)
        return process

    def is_up(self) -> bool:
        """Whether the coordinator takes the robot to be there, by its last summary."""
        for received in self._summaries.drain():
            self._is_up = any(robot.name == "r1" and robot.up for robot in received.message.robots)
        return self._is_up

    def states(self) -> dict[TaskState, Counter[str]]:
        """How often each task became what, since the last call."""
        counts: dict[TaskState, Counter[str]] = {state: Counter() for state in TaskState}
        for received in self._events.drain():
            counts[received.message.state][received.message.task.id] += 1
        return counts

    def close(self) -> None:
        self.wire.close()
        self.wire.session.close()  # type: ignore[no-untyped-call]


@pytest.fixture
def hosts(commands: Commands) -> Iterator[SecuredHosts]:
    with relayed_network() as network, closing(SecuredHosts(commands, network)) as found:
        yield found
        commands.stop_all()


def test_cut_between_two_routers_loses_no_task_and_doubles_none(hosts: SecuredHosts) -> None:
    until(hosts.is_up, "r1 never comes")
    names = []
    for number, place in enumerate((Point2D(7.0, 4.0),)):
        task = Task(id=f"t{number}", kind="visit", place=place)
        until_answered(lambda task=task: hosts.wire.ask(TASK_SUBMIT, TaskSubmission(task=task)))
        names.append(task.id)
    until(lambda: hosts.states()[TaskState.RUNNING], "no task was begun")
    hosts.network.is_cut = True
    cut_s = time.monotonic()
    until(lambda: not hosts.is_up(), "its absence is not noticed")
    noticed_s = time.monotonic() - cut_s
    time.sleep(max(0.0, cut_s + 4.0 - time.monotonic()))
    hosts.states()
    hosts.network.is_cut = False
    healed_s = time.monotonic()
    until(hosts.is_up, "it does not come back")
    back_s = time.monotonic() - healed_s
    done: Counter[str] = Counter()

    def are_done() -> bool:
        done.update(hosts.states()[TaskState.DONE])
        return set(names) <= done.keys()

    until(are_done, "not all tasks are done", pause_s=0.1)
    assert max(done[name] for name in names) == 1
    records = until_answered(lambda: hosts.wire.ask(TASK_LIST, TaskFilter(limit=100)))
    assert {record.state for record in records if record.task.id in names} == {TaskState.DONE}
    assert noticed_s < NOTICED_S
    assert back_s < BACK_S
    assert [process.poll() for process in hosts.processes] == [None] * 5
