"""A recorded run is put through the allocator again: it decides the same."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.plan_messages import TASK_ESTIMATES, TASK_PROBLEM
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.session import open_lockstep_session
from robrain.recording.provenance import Provenance
from robrain.recording.writer.recorder import Recorder
from tests.coordinator.conftest import Team
from tests.coordinator.planning.recorded_plans import replay_decisions
from tests.coordinator.planning.worlds import CAPACITY_J, Worker, run

PROVENANCE = Provenance(scenario="room", scenario_toml="", seed=1, map_png=b"", drive="lockstep", team="default")


@pytest.mark.slow
def test_a_recorded_run_decides_the_same_again(team, tmp_path):
    path = tmp_path / "run.mcap"
    recorder = Recorder(team.endpoint(), path, PROVENANCE)
    workers = [Worker(team.robot(f"r{number}", 4.0 + 2.0 * number), remaining_j=CAPACITY_J) for number in range(3)]
    team.closed_room()
    run(team, workers, 1.0)
    for number in range(8):
        after = (f"t{number - 3}",) if number % 4 == 3 else ()
        task = Task(
            id=f"t{number}", kind="visit", place=Point2D(3.5 + 0.6 * number, 2.5 + 3.0 * (number % 2)), after=after
        )
        team.submit(task, deadline_in_s=100.0 if number % 3 else None)
    done = run(team, workers, 100.0, until=lambda: set(team.states().values()) == {TaskState.DONE}, check=recorder.step)
    recorder.close()
    assert done
    plans = list(replay_decisions(path))
    assert len(plans) > 5
    assert all(plan.is_same for plan in plans)
    assert plans[0].recorded.cause.endswith("more")


def digest() -> str:
    """Of all that is said of the plans of a run in which robots can do different things, and refuse some."""
    with open_lockstep_session() as session:
        team = Team(session)
        inbox = Inbox(10_000, every=True)
        ears = team.endpoint()
        for topic in (TASK_PROBLEM, TASK_ESTIMATES):
            ears.subscribe(inbox, topic)
        workers = []
        for number, extra in enumerate((["camera"], ["sensor_board", "arm"], ["camera", "arm"])):
            robot = team.robot(f"r{number}", 4.0 + 2.0 * number)
            robot.plugins = ["visit", "explore", *extra]
            robot.accepts = number != 1
            workers.append(Worker(robot, remaining_j=CAPACITY_J))
        team.closed_room()
        run(team, workers, 1.0)
        for number in range(9):
            needs = ((), ("camera", "arm"), ("sensor_board",))[number % 3]
            place = Point2D(3.5 + 0.6 * number, 2.5 + 3.0 * (number % 2))
            team.submit(Task(id=f"t{number}", kind="visit", place=place, needs=needs), deadline_in_s=60.0)
        run(team, workers, 20.0)
        found = hashlib.sha256(b"".join(payload for _, _, payload in inbox.drain_raw())).hexdigest()
        team.close()
        return found


@pytest.mark.slow
def test_what_is_said_of_plans_does_not_depend_on_the_hash_seed():
    code = "from tests.coordinator.planning.test_replaying import digest; import sys; sys.stdout.write(digest())"
    said = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[3],
        env={**os.environ, "PYTHONHASHSEED": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert said.stdout == digest()  # this process has another hash seed
