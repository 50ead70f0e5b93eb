"""Ctrl-C while a run is set up: everything opened is closed in order, without output."""

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.system

# The script reports this point and waits, so that the signal arrives while robots are set up.
SCRIPT = """
import sys

from robrain.agent.host.agent_host import AgentHost as Original
import robrain.sim.lockstep.lockstep as user

made = 0


class Told(Original):
    def __init__(self, *args, **options):
        global made
        super().__init__(*args, **options)
        made += 1
        print("made", made, flush=True)
        if made == 2:
            sys.stdin.readline()


user.AgentHost = Told
sys.argv = ["robrain", "run", "arena_small", "--robots", "3", "--time-limit", "1"]
from robrain.cli import main

main()
"""


def test_ctrl_c_while_robots_are_set_up_closes_them_without_a_word() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT],
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
