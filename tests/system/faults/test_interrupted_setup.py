"""Ctrl-C while a run is set up: everything opened is closed in order, without output."""

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.system

# The script reports this point and waits, so that the signal arrives while robots are set up.
SCRIPT = """
import sys

from robrain.{module} import {name} as Original
import robrain.{user} as user

made = 0


class Told(Original):
    def __init__(self, *args, **options):
        global made
        super().__init__(*args, **options)
        made += 1
        print("made", made, flush=True)
        if made == 2:
            sys.stdin.readline()


user.{name} = Told
sys.argv = ["robrain", "run", "arena_small", "--robots", "3", "--time-limit", "1"]
from robrain.cli import main

main()
"""


@pytest.mark.parametrize(
    ("module", "name", "user"),
    [
        ("sim.robot.simulated_robot", "SimulatedRobot", "sim.robot.robot_team"),
        ("agent.host.agent_host", "AgentHost", "sim.lockstep.lockstep"),
    ],
)
def test_ctrl_c_while_robots_are_set_up_closes_them_without_a_word(module: str, name: str, user: str) -> None:
    script = SCRIPT.format(module=module, name=name, user=user)
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    with process:
        assert process.stdout is not None
        assert process.stdin is not None
        said = []
        for line in process.stdout:
            said.append(line)
            if line == "made 2\n":
                break
        process.send_signal(signal.SIGINT)
        process.stdin.write("go on\n")
        process.stdin.close()
        said += process.stdout.readlines()
    assert process.returncode == 130
    assert [line for line in said if "made" not in line][1:] == [], "only the first line tells what is run"
