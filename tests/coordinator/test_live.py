"""What a live coordinator loads before it is up: robots that wait for it let go of their tasks."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

SLOW = ("numba", "scipy", "pyvrp", "pandas", "matplotlib", "viser", "mcap", "PIL", "rich", "can", "prompt_toolkit")
LOADED = """
import sys
import robrain.cli, robrain.deploy.processes.coordinator_process
import robrain.coordinator.live, robrain.coordinator.journal.journal
print(*sorted({name.partition(".")[0] for name in sys.modules}))
"""


def test_a_coordinator_loads_nothing_slow_before_it_is_up():
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"robrain", "zenoh", "numpy"} <= loaded
    assert not loaded & set(SLOW)
