"""Fails a run in which a test without the marker `slow` uses more than a second of CPU time.

CPU time counts, not wall time: it depends little on what else the machine does. A test is charged for its own process
and for all processes below it. The set-up of fixtures that several tests share is charged to none of them. Only runs
with worker processes are judged: in these, everything that is loaded at its first use is loaded before the first test.
"""

import gc
import importlib
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings, strategies

from tests.system.prefork import import_everything

CPU_MAX_S = 1.0
FULL = 2
"""Generation of a search for garbage among all objects."""
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
PROC = Path("/proc")


def process_cpu_s(pid: int) -> float:
    """CPU time of a process, of its ended children and of all processes below it, in seconds; 0 if it has ended."""
    try:
        fields = (PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
        tasks = list((PROC / str(pid) / "task").iterdir())
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    user, system, children_user, children_system = (int(ticks) for ticks in fields[11:15])
    children = []
    for task in tasks:
        with suppress(FileNotFoundError, ProcessLookupError):  # a thread that has just ended
            children += (task / "children").read_text().split()
    own_s = (user + system + children_user + children_system) / TICKS_PER_S
    return own_s + sum(process_cpu_s(int(child)) for child in children)


def used_cpu_s() -> float:
    """CPU time of this process, of its ended children and of all processes below it, in seconds."""
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:  # there is no child whose threads would have to be looked at, which takes a millisecond
        return sum(os.times()[:4])
    return process_cpu_s(os.getpid())


@settings(max_examples=200, database=None, derandomize=True)
@given(strategies.text())
def _draw_text(_: str) -> None:
    """Have hypothesis make its table of characters and read the constants of all modules: 7 s once in a clone."""


class CpuBudget:
    """Measures each test where it runs, and judges the whole run where the results arrive."""

    def __init__(self, *, is_worker: bool, judges: bool) -> None:
        self._is_worker = is_worker
        self._judges = judges
        self._shared_s = 0.0
        self._exceeded: dict[str, float] = {}

    def pytest_runtestloop(self) -> None:
        """Load kernels and libraries, so that no test is charged for them."""
        if self._is_worker:
            import_everything()
            importlib.import_module("matplotlib.pyplot")
            importlib.import_module("pandas")
            _draw_text()
            gc.callbacks.append(self._charge_nobody)

    def _charge_nobody(self, phase: str, info: dict[str, int]) -> None:
        """Charge no test for a search for garbage among all objects of the process."""
        if info["generation"] == FULL:
            self._shared_s += time.process_time() if phase == "stop" else -time.process_time()

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Remember the CPU time before the test."""
        self._shared_s = 0.0
        self._start_s = used_cpu_s()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Iterator[object]:
        """Add up what shared fixtures cost, except within each other."""
        if fixturedef.scope == "function":
            return (yield)
        before_s, shared_s = used_cpu_s(), self._shared_s
        try:
            return (yield)
        finally:
            self._shared_s = shared_s + used_cpu_s() - before_s

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
        """Attach the CPU time of the whole test to the report of its end."""
        report: Any = yield
        if call.when == "teardown":
            report.cpu_s = used_cpu_s() - self._start_s - self._shared_s
            report.is_slow = item.get_closest_marker("slow") is not None
        return report

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Collect the tests that used more than they may."""
        if self._judges and report.when == "teardown" and not report.is_slow and report.cpu_s > CPU_MAX_S:
            self._exceeded[report.nodeid] = report.cpu_s

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail the run."""
        if self._exceeded and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Name the tests, the most expensive first."""
        if self._exceeded:
            terminalreporter.section(
                f"more than {CPU_MAX_S:g} s of CPU time without the marker slow", red=True, bold=True
            )
            for nodeid, cpu_s in sorted(self._exceeded.items(), key=lambda one: -one[1]):
                terminalreporter.line(f"{cpu_s:6.2f} s  {nodeid}", red=True)


def pytest_configure(config: pytest.Config) -> None:
    """Measure in every process that runs tests."""
    is_worker = hasattr(config, "workerinput")
    judges = not is_worker and config.getoption("numprocesses", None)
    config.pluginmanager.register(CpuBudget(is_worker=is_worker, judges=bool(judges)))
