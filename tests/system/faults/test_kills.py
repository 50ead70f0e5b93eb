"""Processes are killed and stopped while tasks run; `make soak` does a few hundred of these."""

import itertools
import os
import re
import signal

import pytest

from robrain import Team
from robrain.protocol.messages.tasks.task_messages import TaskChange, TaskRecord
from robrain.protocol.model.tasks.task import TaskState
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system


def test_a_robot_whose_process_is_stopped_loses_its_task_and_is_told_to_stop_when_it_returns(commands) -> None:
    """SIGSTOP: its liveliness token stays for many seconds; only its silence tells."""
    endpoint = commands.arena("arena_small", "--robots", "2")
    agents = commands.agents("r1", "r2")
    commands.coordinator(endpoint)
    with Team.connect(endpoint, patience_s=PATIENCE_S) as client:
        client.submit("visit", id="t1", place=(2.0, 1.0), service_s=4.0)
        running = until(lambda: _running(client), "nobody begins the task")
        stopped, before = running.robot, client.why("t1").changes[-1].number
        os.kill(agents[stopped].pid, signal.SIGSTOP)
        try:
            lost, freed = until(lambda: _lost_and_freed(client, before), "the task was never freed")
        finally:
            os.kill(agents[stopped].pid, signal.SIGCONT)
        # After a stall of the coordinator's own the token may have gone by the time that it looks.
        silence = re.fullmatch(r"lost contact ([\d.]+) s ago|gone", lost.why)
        assert silence, lost
        assert float(silence[1] or 0.8) >= 0.8, lost
        assert freed.why == f"{stopped} is silent, and the lease ran out"
        assert freed.stamp_ns > lost.stamp_ns
        assert client.wait("t1", timeout_s=PATIENCE_S).state is TaskState.DONE
        assert _states(client).count(TaskState.DONE) == 1


def _running(client: Team) -> TaskRecord | None:
    record = client.get("t1")
    return record if record.state is TaskState.RUNNING else None


def _lost_and_freed(client: Team, before: int) -> tuple[TaskChange, TaskChange] | None:
    """The silence in which the task was given back; on a busy machine a robot may be silent before, and come back."""
    changes = [change for change in client.why("t1").changes if change.number > before]
    for lost, freed in itertools.pairwise(changes):
        if (lost.state, freed.state) == (TaskState.LOST_CONTACT, TaskState.QUEUED):
            return lost, freed
    return None


def _states(client: Team) -> list[TaskState]:
    return [change.state for change in client.why("t1").changes]
