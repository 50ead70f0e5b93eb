"""What setting a run up does without."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

SCRIPT = """
from numba.core import event


class Compiled(event.Listener):
    def on_start(self, event):
        print("compiles", event.data["dispatcher"].py_func.__qualname__, flush=True)

    def on_end(self, event):
        pass


event.register("numba:compile", Compiled())
from robrain import Scenario

scenario = Scenario.builtin("depot")
run = scenario.open(scenario.world())
print("set up", len(run.hosts))
run.close()
"""


def test_set_up_of_a_run_compiles_nothing(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )
    assert done.stdout == "set up 4\n"
