"""The process that makes plans: killed, stopped, interrupted, left alone, it costs the coordinator no question."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from robrain.coordinator.planning.live_planner import LivePlanner
from robrain.coordinator.planning.policy import PlanningPolicy
from tests.coordinator.planning.snapshots import open_floor_snapshot
from tests.waiting import PATIENCE_S, has_ended, until

ROOT = Path(__file__).parents[3]
LONG = PlanningPolicy(deadline_s=600.0, iterations=10**9)
"""A search that is under way for as long as a test looks at it."""
SHORT = PlanningPolicy(deadline_s=0.2)
PARENT = """
import threading
from robrain.coordinator.planning.live_planner import LivePlanner
from robrain.coordinator.planning.policy import PlanningPolicy
from tests.coordinator.planning.snapshots import open_floor_snapshot

made = threading.Event()
planner = LivePlanner(made.set)
planner.ask(open_floor_snapshot(1, 200, robots=10), PlanningPolicy(deadline_s=600.0, iterations=10**9))
made.wait()
print(planner.pid, flush=True)
threading.Event().wait()
"""


def next_plan(planner, made):
    assert made.wait(PATIENCE_S)
    made.clear()
    return planner.finished_plans()


@pytest.mark.slow
def test_a_process_outlives_an_interrupt_is_replaced_when_it_is_killed_idle_or_amid_a_plan_and_ends_when_closed(
    planner, made, caplog, capfd
):
    planner.ask(open_floor_snapshot(1, 3), SHORT)
    next_plan(planner, made)
    first = planner.pid
    assert os.getpgid(first) != os.getpgid(0)
    assert os.getpriority(os.PRIO_PROCESS, first) > os.getpriority(os.PRIO_PROCESS, 0)
    os.kill(first, signal.SIGINT)  # as for the whole terminal
    until(lambda: not planner.is_busy)
    planner.ask(open_floor_snapshot(2, 3), SHORT)
    assert next_plan(planner, made)[-1].problem.plan == 2
    assert planner.pid == first
    until(lambda: not planner.is_busy)
    os.kill(first, signal.SIGKILL)
    planner.ask(open_floor_snapshot(7, 200, robots=10), LONG)
    assert next_plan(planner, made)[-1].problem.plan == 7
    second = planner.pid
    os.kill(second, signal.SIGKILL)
    until(lambda: planner.pid not in (second, None))
    assert planner.is_busy
    assert next_plan(planner, made)[-1].problem.plan == 7
    assert "was ended by SIGKILL" in caplog.text
    third = planner.pid
    planner.close()
    assert has_ended(third)
    with pytest.raises(ProcessLookupError):  # it was waited for
        os.kill(third, 0)
    assert not [one for one in threading.enumerate() if one.name.startswith("planner")]
    planner.ask(open_floor_snapshot(8, 3), SHORT)  # nobody does so, but nothing comes of it
    assert planner.pid is None
    assert "Traceback" not in capfd.readouterr().err


def test_closing_while_it_starts_leaves_no_process(made):
    planner = LivePlanner(made.set)
    planner.prepare()
    until(lambda: planner.pid is not None)
    pid = planner.pid
    planner.close()
    assert has_ended(pid)


@pytest.mark.slow
def test_when_the_coordinator_is_killed_the_process_ends_though_it_was_stopped_amid_a_search():
    parent = subprocess.Popen([sys.executable, "-c", PARENT], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        stopped = int(parent.stdout.readline())
        assert not has_ended(stopped)
        os.kill(stopped, signal.SIGSTOP)
    finally:
        parent.kill()
        parent.communicate()
    until(lambda: has_ended(stopped))
