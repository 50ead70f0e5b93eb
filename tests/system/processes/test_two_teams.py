"""Two live teams on one hub, with robots of the same names: neither hears, commands or halts the other."""

import json

import pytest

from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.tasks.task_messages import TASK_LIST, TASK_SUBMIT, TaskFilter, TaskSubmission
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.endpoint import Drive, Endpoint
from tests.asking import until_answered
from tests.system.conftest import endpoint_of
from tests.waiting import until

pytestmark = pytest.mark.system

ROBOT = '[robot]\nname = "r1"\nload = ["counter", "command"]\n'
TEAMS = ("north", "south")


@pytest.fixture
def where(commands, hub) -> str:
    """The hub, with a coordinator of each team."""
    for team in TEAMS:
        commands.coordinator(endpoint_of(hub), "--team", team)
    return endpoint_of(hub)


def test_two_teams_of_one_hub_do_not_see_each_other(commands, hub, where) -> None:
    heard: dict[str, set[str]] = {team: set() for team in TEAMS}
    payloads: dict[str, list[bytes]] = {team: [] for team in TEAMS}

    def listen(team: str):
        def take(sample) -> None:
            heard[team].add(str(sample.key_expr).split("/")[1])
            payloads[team].append(sample.payload.to_bytes())

        return hub.declare_subscriber(f"robrain/{team}/**", take)

    listeners = [listen(team) for team in TEAMS]
    wires = {team: Endpoint(hub, team, LiveClock(), Drive.LIVE) for team in TEAMS}
    states = {team: Inbox(every=True) for team in TEAMS}
    for team in TEAMS:
        wires[team].subscribe(states[team], ROBOT_STATE)

    def run(*words: str):
        return commands.run_here(*words, "--connect", where)

    task = Task(id="only-northern", kind="visit", place=Point2D(1.0, 1.0))
    until_answered(lambda: wires["north"].ask(TASK_SUBMIT, TaskSubmission(task=task)))
    (commands.folder / "r1.toml").write_text(ROBOT)
    for team in TEAMS:
        agent = commands.start("agent", "r1.toml", "--connect", where, "--team", team)
        commands.line_with(agent, "agent: r1 is up")
    for team in TEAMS:
        status = json.loads(run("status", "--team", team, "--json").stdout)
        assert (status["team"], status["robots"], status["coordinator"]) == (team, ["r1"], True)
    assert [record.task.id for record in tasks_of(wires["north"])] == ["only-northern"]
    assert tasks_of(wires["south"]) == []
    # Orders to everybody mean everybody of one team.
    halted = run("halt", "--team", "north", "--reason", "only-northern")
    assert halted.returncode == 0, halted.stderr
    cancelled = run("task", "cancel", "only-northern", "--team", "south")
    assert cancelled.returncode != 0
    is_halted = dict.fromkeys(TEAMS, False)
    after = dict.fromkeys(TEAMS, 0)

    def both_have_spoken() -> bool:
        for team in TEAMS:
            for received in states[team].drain():
                is_halted[team] |= received.message.halted
                after[team] += 1
        return is_halted["north"] and min(after.values()) > 20

    until(both_have_spoken, "no states came")
    assert is_halted == {"north": True, "south": False}
    assert [record.state for record in tasks_of(wires["north"])] == ["queued"]
    for listener in listeners:
        listener.undeclare()
    for wire in wires.values():
        wire.close()
    assert heard == {team: {team} for team in TEAMS}
    assert any(b"only-northern" in payload for payload in payloads["north"])
    assert not any(b"only-northern" in payload for payload in payloads["south"])


def tasks_of(wire: Endpoint):
    return until_answered(lambda: wire.ask(TASK_LIST, TaskFilter()))
