"""What goes wrong in an isolated plugin stays in its process."""

import gc
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import pytest

from robrain.agent.errors import PluginCrashed
from robrain.agent.isolation.isolated_plugin import Limits
from robrain.agent.plugin_traceback import raised
from robrain.protocol.workers import OwnedThread
from tests.agent.isolation.isolation_bench import IsolationBench
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.slow

PATIENT = Limits(call_s=PATIENCE_S, start_s=PATIENCE_S, halt_s=PATIENCE_S, memory_mb=800)
QUICK = Limits(call_s=0.5, start_s=PATIENCE_S, halt_s=PATIENCE_S, memory_mb=800)
"""For calls that never end; what does end has all the time that a busy machine takes."""

FRAGILE = """
def grow():
    held = []
    while True:
        held.append(bytearray(50_000_000))

def leave_once_there_is(path):
    while not os.path.exists(path):
        time.sleep(0.01)
    os._exit(4)

class Vision(Unit):
    period_s = 0.1
    halts = 0
    def step(self): pass
    def emergency_halt(self): self.halts += 1
    @external
    def abort(self) -> None: os.abort()
    @external
    def segfault(self) -> None: ctypes.string_at(0)
    @external
    def leave(self) -> None: os._exit(3)
    @external
    def loop(self) -> None:
        while True: pass
    @external
    def loop_in_native_code(self) -> None: re.match("(a+)+$", "a" * 60 + "b")
    @external
    def grow(self) -> None: grow()
    @external
    def leave_later(self, path: str) -> None: threading.Thread(target=leave_once_there_is, args=[path]).start()
    @external
    def halted(self) -> int: return self.halts
"""


@pytest.fixture
def bench(tmp_path):
    bench = IsolationBench(tmp_path)
    yield bench
    bench.close()


@pytest.fixture
def fragile(bench):
    return bench.start(FRAGILE, limits=PATIENT)


def gone(pid):
    """Whether the process has ended, as it does sooner or later; a child of this one must also have been reaped."""

    def has_gone():
        try:
            state, parent = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[:2]
        except (FileNotFoundError, ProcessLookupError):  # the latter if it ends between opening and reading
            return True
        return state == "Z" and int(parent) != os.getpid()

    return until(has_gone, f"process {pid} has not ended")


def test_a_crash_is_an_error_of_the_plugin(fragile):
    check_crash(fragile, "abort", "vision was ended by SIGABRT in abort")
    fragile.activate()  # in a new process
    check_crash(fragile, "segfault", "vision was ended by SIGSEGV in segfault")
    fragile.activate()
    check_crash(fragile, "leave", "vision has ended with status 3 in leave")


def test_a_call_that_does_not_end_is_an_error_of_the_plugin(bench):
    stuck = bench.start(FRAGILE, limits=QUICK)
    error = check_crash(stuck, "loop", r"did not come back from loop within 0\.5 s, and its process was killed")
    assert raised(error).where.endswith(" in loop")
    stuck.activate()
    error = check_crash(stuck, "loop_in_native_code", r"did not come back from loop_in_native_code within 0\.5 s")
    assert raised(error).where == ""


def check_crash(vision, function, text):
    pid = vision.pid
    with pytest.raises(PluginCrashed, match=text) as caught:
        getattr(vision, function)()
    assert caught.value.plugin == "vision"
    assert vision.pid is None
    assert gone(pid)
    with pytest.raises(PluginCrashed, match=r"vision (was ended|has ended|did not come back)"):
        vision.halted()
    return caught.value


def test_memory_beyond_the_limit_is_not_given_and_the_plugin_lives(bench):
    fragile = bench.start(FRAGILE, limits=Limits(call_s=PATIENCE_S, start_s=PATIENCE_S, memory_mb=400))
    with pytest.raises(MemoryError):
        fragile.grow()
    assert fragile.halted() == 0


def test_a_crash_that_no_call_runs_into_is_told_through_the_plugins_mailbox(bench, fragile, tmp_path):
    fragile.leave_later(str(tmp_path / "now"))
    (tmp_path / "now").touch()
    assert bench.env.arrived.wait(PATIENCE_S)
    with pytest.raises(PluginCrashed, match="vision has ended with status 4"):
        bench.env.mailbox.deliver()
    with pytest.raises(PluginCrashed, match="vision has ended with status 4"):
        fragile.step()


def test_waiting_for_a_lower_plugin_is_not_held_against_it(bench):
    class Slow:
        def rest(self) -> int:
            time.sleep(1.5 * QUICK.call_s)
            return 5

    bench.env.others["slow"] = Slow()
    vision = bench.start(
        """
        class SlowInterface(Protocol):
            def rest(self) -> int: ...
        class Vision(Unit):
            def activate(self): self.slow = self.env.use("slow", SlowInterface)
            @external
            def rest(self) -> int: return self.slow.rest()
        """,
        limits=QUICK,
    )
    assert vision.rest() == 5


def test_emergency_halt_gets_through_a_call_that_is_under_way(bench):
    vision = bench.start(
        """
        class Vision(Unit):
            halts = 0
            def emergency_halt(self): self.halts += 1
            @external
            def wait_for_halt(self) -> int:
                while not self.halts: time.sleep(0.001)
                return self.halts
        """
    )
    answered = []
    caller = OwnedThread("caller", lambda: answered.append(vision.wait_for_halt()))
    time.sleep(0.05)
    vision.emergency_halt()
    caller.close(PATIENCE_S)
    assert answered == [1]


def test_a_process_that_does_not_halt_is_killed(bench):
    vision = bench.start(FRAGILE, limits=Limits(call_s=PATIENCE_S, start_s=PATIENCE_S, halt_s=0.2))
    errors = []

    def call():
        try:
            vision.loop_in_native_code()
        except PluginCrashed as error:
            errors.append(error)

    def halt():
        """Halt it; how that failed, once the call is where nothing gets through to it."""
        try:
            vision.emergency_halt()
        except PluginCrashed as error:
            return str(error)
        return ""

    caller = OwnedThread("caller", call)
    assert "did not halt within 0.2 s" in until(halt)
    caller.close(PATIENCE_S)
    assert len(errors) == 1


def test_a_plugin_that_is_dropped_takes_its_process_along(bench):
    vision = bench.start(FRAGILE)
    pid = vision.pid
    bench.plugins.clear()
    bench.env.mailbox = None
    del vision
    gc.collect()
    assert gone(pid)


PARENT = """
import sys, tempfile, threading
from pathlib import Path
from tests.agent.isolation.isolation_bench import IsolationBench
from tests.agent.isolation.test_isolation_crash import FRAGILE
bench = IsolationBench(Path(sys.argv[1]))
vision = bench.start(FRAGILE)
print(vision.pid, flush=True)
threading.Thread(target=vision.loop_in_native_code, daemon=True).start()
sys.stdin.read()
"""


def test_the_process_ends_with_its_parent_whatever_it_is_at(tmp_path):
    parent = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(PARENT), str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[3],
    )
    with parent:
        pid = int(parent.stdout.readline())
        time.sleep(0.2)
        parent.send_signal(signal.SIGKILL)
    assert gone(pid)


def test_five_restarts_leave_no_process_thread_or_descriptor(bench):
    vision = bench.start(FRAGILE, limits=PATIENT)
    vision.deactivate()
    before = len(os.listdir("/proc/self/fd"))
    pids = set()
    for round_number in range(5):
        vision.activate()
        pids.add(vision.pid)
        if round_number % 2:
            vision.deactivate()
        else:
            with pytest.raises(PluginCrashed):
                vision.abort()
    assert len(pids) == 5
    until(lambda: not any(thread.name.startswith("isolated-") for thread in threading.enumerate()))
    until(lambda: len(os.listdir("/proc/self/fd")) <= before)
    assert [pid for pid in pids if Path(f"/proc/{pid}").exists()] == []  # not as zombies either
