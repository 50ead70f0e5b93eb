"""A forked command behaves as one that was started with a new interpreter."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.system.conftest import ROOT, Commands
from tests.waiting import PATIENCE_S, has_ended, until

pytestmark = pytest.mark.system


@pytest.mark.parametrize("words", [["--version"], ["run", "nosuch"]])
def test_forked_command_says_and_returns_what_a_started_one_does(commands: Commands, words: list[str]) -> None:
    forked = commands.run(*words)
    started = subprocess.run(
        [sys.executable, "-m", "robrain.cli", *words],
        cwd=commands.folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (forked.returncode, forked.stdout, forked.stderr) == (started.returncode, started.stdout, started.stderr)


def test_forked_command_has_its_own_folder_variables_session_and_input(commands: Commands) -> None:
    waiting = commands.start("coordinator", stdin=subprocess.PIPE, COLUMNS="77")
    commands.line_with(waiting, "waiting for")
    process = Path(f"/proc/{waiting.pid}")
    assert (process / "cwd").resolve() == commands.folder
    assert os.getsid(waiting.pid) == waiting.pid
    assert os.readlink(process / "fd/0").startswith("pipe:")
    assert commands.run("status", COLUMNS="99").returncode == 2
    assert waiting.poll() is None


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 0), (signal.SIGTERM, 0)]
)
def test_signals_reach_a_forked_command(commands: Commands, number: signal.Signals, status: int) -> None:
    waiting = commands.start("coordinator")
    commands.line_with(waiting, "waiting for")
    waiting.send_signal(number)
    assert waiting.wait(PATIENCE_S) == status
    assert not Path(f"/proc/{waiting.pid}").exists()


def test_a_command_ends_with_the_tests_that_started_it() -> None:
    script = """
import os, subprocess
from tests.system.prefork import end_with_parent
print(subprocess.Popen(["sleep", "1000"], preexec_fn=end_with_parent).pid, flush=True)
os.kill(os.getpid(), 9)
"""
    said = subprocess.run([sys.executable, "-c", script], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    assert said.returncode == -signal.SIGKILL
    until(lambda: has_ended(int(said.stdout)), "it ends too")
