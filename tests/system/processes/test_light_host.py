"""The host alone is light: what it loads, how many threads it has, and what it says of plugins that need more."""

import subprocess
import sys
import time

import pytest

from robrain.deploy.processes.agent_process import Pages, unchanged_pages
from robrain.protocol.wire.session import open_session
from tests.bench.host_weight import ALONE, weigh
from tests.system.conftest import Commands
from tests.waiting import until

pytestmark = pytest.mark.system

THREADS_MAX = 16
"""When nothing is asked."""
PASSING = 4
"""Each query that waits for replies has a thread for a moment."""
WEIGHED = 20
HEAVY = ("numpy", "scipy", "numba", "llvmlite", "pydantic", "rich", "prompt_toolkit", "jsonschema")
PLAIN = {"mocdevice", "scan", "range_sensors", "bm2", "driver", "obstacle_distance", "command", "counter", "home"}
LOADED = f"""
import sys
from robrain.cli import agent_arguments
from robrain.agent.lifecycle.plugin_folders import PluginFolders
from robrain.agent.class_import import import_class
from robrain.agent.host.agent_host import stock_place
from robrain.agent.manifest import read_manifest
from robrain.deploy.processes import agent_process
found = PluginFolders([stock_place()]).find()
for name in {sorted(PLAIN)}:
    import_class(read_manifest(found[name]))
print(*sorted(name for name in {HEAVY} if name in sys.modules))
"""


@pytest.fixture
def alone(commands: Commands) -> "subprocess.Popen[str]":
    """A host with three plugins and what these require, in an interpreter of its own."""
    (commands.folder / "r1.toml").write_text(ALONE)
    # A variable of the interpreter: a process that is forked from one with all of robrain would have its memory.
    return commands.start("agent", "r1.toml", PYTHONHASHSEED="0")


def test_the_host_and_the_plain_plugins_load_no_arrays_no_compiler_and_no_library_for_terminals() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_a_host_alone_has_few_threads_and_little_memory(commands: Commands, alone: "subprocess.Popen[str]") -> None:
    hub = open_session(mode="router", listen=[commands.hub.endpoint])
    try:
        commands.line_with(alone, "agent: r1 is up with 5 plugins")
        until(lambda: weigh(alone.pid).threads <= THREADS_MAX)
        weights = [weigh(alone.pid) for _ in range(WEIGHED) if time.sleep(0.1) is None]
        assert 5 < min(weight.threads for weight in weights) <= THREADS_MAX
        assert max(weight.threads for weight in weights) <= THREADS_MAX + PASSING
        assert 20 < weights[-1].resident_mb < 80
    finally:
        commands.stop_all()
        hub.close()  # type: ignore[no-untyped-call]


SMAPS = """\
1000-3000 r-xp 00000000 08:01 42   /lib/libllvmlite.so
Rss:                 8 kB
Anonymous:           0 kB
3000-4000 r--p 00002000 08:01 42   /lib/libllvmlite.so
Anonymous:           4 kB
4000-5000 rw-p 00003000 08:01 42   /lib/libllvmlite.so
Anonymous:           0 kB
5000-6000 r-xp 00000000 08:01 43   /lib/libother.so
Anonymous:           0 kB
7000-8000 rw-p 00000000 00:00 0
Anonymous:           0 kB
"""


def test_only_pages_of_the_library_that_nobody_has_changed_are_given_back() -> None:
    assert unchanged_pages(SMAPS, "libllvmlite") == [Pages(0x1000, 0x2000)]
