"""A forked command behaves as one that was started with a new interpreter."""

import signal
import subprocess
import sys

import pytest

from tests.system.conftest import ROOT, Commands
from tests.waiting import has_ended, until

pytestmark = pytest.mark.system


@pytest.mark.parametrize("words", [["--version"], ["run", "nosuch"]])
def test_forked_command_says_and_returns_what_a_started_one_does(commands: Commands, words: list[str]) -> None:
    forked = commands.run(*words)
    started = subprocess.run(
        [sys.executable, "-m", "robrain.cli", *words],
        cwd=commands.folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (forked.returncode, forked.stdout, forked.stderr) == (started.returncode, started.stdout, started.stderr)


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
