"""Processes are killed and stopped while tasks run; `make soak` does a few hundred of these."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robrain import TaskClient
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.task import TaskState, Visit
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]


@pytest.mark.timeout(400)
@pytest.mark.parametrize(("victim", "kills"), [("coordinator", 4), ("agent", 3)])
def test_every_task_ends_once_whatever_is_killed(victim: str, kills: int) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.system.soak", "--of", victim, "--kills", str(kills), "--seed", "7"],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=390,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-4000:]
    found = json.loads(done.stdout)
    assert found["kills"] == kills
    assert found["tasks"] >= 5
    assert found["done"] >= 1
    assert found["done"] == found["done_and_seen_on_the_wire"]


def test_a_robot_whose_process_is_stopped_loses_its_task_and_is_told_to_stop_when_it_returns(commands) -> None:
    """SIGSTOP: its liveliness token stays for many seconds; only its silence tells."""
    words = ("arena_small", "--robots", "2", "--listen", "tcp/127.0.0.1:0", "--robot-files", ".")
    arena = commands.start("arena", *words)
    endpoint = commands.line_with(arena, "arena: arena_small at ").split(" at ")[1].split(",")[0]
    agents = {name: commands.start("agent", f"{name}.toml") for name in ("r1", "r2")}
    for name, agent in agents.items():
        commands.line_with(agent, f"agent: {name} is up")
    coordinator = commands.start("coordinator", "--connect", endpoint)
    commands.line_with(coordinator, "coordinator: of team default")
    with TaskClient(endpoint) as client:
        client.submit(Visit(id="t1", place=Point2D(4.0, 5.3), service_s=12.0))
        ends_s = time.monotonic() + PATIENCE_S
        while (record := client.get("t1")).state is not TaskState.RUNNING:
            assert time.monotonic() < ends_s, client.why("t1")
            time.sleep(0.05)
        stopped = record.robot
        os.kill(agents[stopped].pid, signal.SIGSTOP)
        try:
            while TaskState.LOST_CONTACT not in (states := _states(client)) or states[-1] is TaskState.LOST_CONTACT:
                assert time.monotonic() < ends_s + 60, client.why("t1")
                time.sleep(0.05)
        finally:
            os.kill(agents[stopped].pid, signal.SIGCONT)
        changes = client.why("t1").changes
        lost = next(change for change in changes if change.state is TaskState.LOST_CONTACT)
        freed = next(change for change in changes if change.number > lost.number)
        silence_s = float(re.search(r"lost contact ([\d.]+) s ago", lost.why)[1])
        assert silence_s >= 1.0, lost
        assert (freed.state, freed.why) == (TaskState.QUEUED, f"{stopped} is silent, and the lease ran out")
        assert freed.stamp_ns > lost.stamp_ns
        assert client.wait("t1", timeout_s=PATIENCE_S).state is TaskState.DONE
        assert _states(client).count(TaskState.DONE) == 1


def _states(client: TaskClient) -> list[TaskState]:
    return [change.state for change in client.why("t1").changes]
