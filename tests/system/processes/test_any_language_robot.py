"""A robot written from the contract alone: the coordinator offers it tasks, halts it and replaces it."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pytest

from robrain import TaskState, Team
from robrain.protocol.keys import DEFAULT_TEAM
from tests.reference_pages.robot_contract import REQUIRED
from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

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


def test_the_robot_names_every_required_row_and_no_module_of_robrain() -> None:
    source = ROBOT.read_text(encoding="utf-8")
    assert all(f'"{row.name}"' in source for row, _ in REQUIRED)
    assert "robrain" not in re.findall(r"^\s*(?:import|from) (\w+)", source, re.MULTILINE)


def test_it_does_a_task(stage: Stage) -> None:
    done = stage.team.wait(
        stage.team.submit("visit", place=(3.5, 3.0), parameters={"service_s": 0.5}), timeout_s=PATIENCE_S
    )
    assert done.state is TaskState.DONE
    pose = stage.team.state(done.robot).pose
    assert pose is not None
    assert (pose.x_m, pose.y_m) == (3.5, 3.0)


def test_it_halts_with_the_team_and_alone(stage: Stage) -> None:
    for robot in (None, "p1"):
        assert not stage.team.halt(robot).unconfirmed
        until(lambda: stage.team.state("p1").halted)
        assert stage.team.state("p2").halted is (robot is None)
        assert not stage.team.resume(robot).unconfirmed
        until(lambda: not stage.team.state("p1").halted)


def test_a_silent_robot_loses_its_task_to_another_and_drops_it(stage: Stage) -> None:
    task = stage.team.submit("visit", place=(3.0, 9.0), parameters={"service_s": 3.0})
    until(lambda: stage.team.get(task).state is TaskState.RUNNING)
    silent = stage.team.get(task).robot
    stage.robots[silent].send_signal(signal.SIGSTOP)
    until(lambda: stage.team.get(task).robot not in ("", silent))
    stage.robots[silent].send_signal(signal.SIGCONT)
    until(lambda: (status := stage.team.state(silent).task) is not None and status.state is TaskState.CANCELLED)
    assert stage.team.wait(task, timeout_s=PATIENCE_S).robot != silent
