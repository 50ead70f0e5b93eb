"""A client and a robot written from the printed document alone are members of a live team."""

import json
import math
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mcap.reader import make_reader

from robrain import TaskState, Team
from robrain.protocol.keys import DEFAULT_TEAM
from tests.system.conftest import Commands
from tests.system.valid_messages import counts_by_ajv
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

CLIENT = Path(__file__).parents[3] / "examples" / "09_any_language" / "client.py"
ME = "any-language"


class Run:
    """What the client printed, and what the recorder heard."""

    def __init__(self, said: str, recording: Path) -> None:
        self.said = said
        self.recording = recording

    def told(self, key: str) -> list[Any]:
        """The messages of one key, as recorded."""
        with self.recording.open("rb") as stream:
            messages = make_reader(stream).iter_messages(topics=[f"robrain/default/{key}"])
            return [json.loads(message.data) for _, _, message in messages]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """A team of two robots, the client's whole visit to it, and the recording of both."""
    folder = tmp_path_factory.mktemp("any_language")
    commands = Commands(folder)
    try:
        hub = commands.team(2, "--motes", "1")
        recorder = commands.start("record", "--connect", hub, "--output", "run.mcap")
        commands.line_with(recorder, "recording to")
        with Team.connect(hub, patience_s=PATIENCE_S) as team:
            until(lambda: [robot.name for robot in team.state().robots if robot.up] == ["r1", "r2"])
        done = subprocess.run(
            [sys.executable, str(CLIENT), hub],
            input=commands.run_here("wire", "--format", "jsonschema").stdout,
            cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        recorder.send_signal(signal.SIGINT)
        recorder.communicate(timeout=PATIENCE_S)
        yield Run(done.stdout, folder / "run.mcap")
    finally:
        commands.stop_all()


def place_of(state: dict[str, Any]) -> tuple[float, float]:
    return state["pose"]["x_m"], state["pose"]["y_m"]


def test_the_client_lists_the_robots_and_reads_errors(run: Run) -> None:
    assert re.search(r"^r1 is at -?\d+\.\d, -?\d+\.\d\nr2 is at ", run.said)
    assert re.search(r"^an unknown task: refused, \w", run.said, re.MULTILINE)


def test_the_client_drives_a_robot(run: Run) -> None:
    assert re.search(r"^r1 wanders: \d+\.\d m", run.said, re.MULTILINE)
    said = run.told("robot/r1/state")
    walks = [list(walk) for behavior, walk in groupby(said, itemgetter("behavior")) if behavior == "wander"]
    assert max(math.dist(place_of(walk[0]), place_of(walk[-1])) for walk in walks) > 0.1
    assert "wander" not in {state["behavior"] for state in run.told("robot/r2/state")}


def test_the_client_has_a_task_done_and_hears_of_each_change(run: Run) -> None:
    assert re.search(r"^the visit: .*done by r\d$", run.said, re.MULTILINE)
    states = [event["state"] for event in run.told("task/event") if event["task"]["id"].startswith(ME)]
    assert states[0] == "queued"
    assert states[-1] == "done"


def test_the_client_halts_the_team_and_resumes_it(run: Run) -> None:
    assert run.said.endswith("halted: r1, r2\nresumed: r1, r2\n")
    said = [message["halted"] for message in run.told("halt") if message["by"] == ME]
    assert set(said) == {True, False}
    assert said == sorted(said, reverse=True)
    for robot in ("r1", "r2"):
        states = run.told(f"robot/{robot}/state")
        halted = [state["halted"] for state in states]
        assert [ME] in [state["halted_by"] for state in states if state["halted"]]
        assert True in halted
        assert halted[-1] is False


def test_every_message_of_a_live_run_is_valid(run: Run) -> None:
    counts = counts_by_ajv(run.recording)
    for key in ("arena/truth", "coordinator/state", "halt", "robot/r1/path", "robot/r2/state", "task/event"):
        assert counts[f"robrain/default/{key}"]


ROBOT = Path(__file__).parents[3] / "examples" / "09_any_language" / "robot.py"


class Stage(NamedTuple):
    """A coordinator with two robots, none of which is of robrain."""

    team: Team
    robots: dict[str, "subprocess.Popen[str]"]


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    folder = tmp_path_factory.mktemp("any_language")
    commands = Commands(folder)
    with ExitStack() as ends:
        ends.callback(commands.stop_all)
        hub = commands.start("hub", "--listen", "tcp/127.0.0.1:0")
        endpoint = commands.line_with(hub, "hub: ").split()[1]
        commands.start("coordinator", "--connect", endpoint)
        document = commands.run_here("wire", "--format", "jsonschema").stdout
        robots = {}
        for name in ("p1", "p2"):
            words = [sys.executable, str(ROBOT), endpoint, name]
            process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
            robots[name] = ends.enter_context(process)
            ends.callback(robots[name].kill)
            stdin = robots[name].stdin
            assert stdin is not None
            stdin.write(document)
            stdin.close()
        with Team.connect(endpoint, team=DEFAULT_TEAM, patience_s=PATIENCE_S) as team:
            until(lambda: team.robots == ["p1", "p2"])
            yield Stage(team, robots)


def test_it_does_a_task(stage: Stage) -> None:
    done = stage.team.wait(
        stage.team.submit("visit", place=(3.5, 3.0), parameters={"service_s": 0.5}), timeout_s=PATIENCE_S
    )
    assert done.state is TaskState.DONE
    pose = stage.team.state(done.robot).pose
    assert pose is not None
    assert (pose.x_m, pose.y_m) == (3.5, 3.0)


def test_a_silent_robot_loses_its_task_to_another_and_drops_it(stage: Stage) -> None:
    task = stage.team.submit("visit", place=(3.0, 9.0), parameters={"service_s": 3.0})
    until(lambda: stage.team.get(task).state is TaskState.RUNNING)
    silent = stage.team.get(task).robot
    stage.robots[silent].send_signal(signal.SIGSTOP)
    until(lambda: stage.team.get(task).robot not in ("", silent))
    stage.robots[silent].send_signal(signal.SIGCONT)
    until(lambda: (status := stage.team.state(silent).task) is not None and status.state is TaskState.CANCELLED)
    assert stage.team.wait(task, timeout_s=PATIENCE_S).robot != silent
