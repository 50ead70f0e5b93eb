"""Robots have a simulated door opened; tasks behind one that fails wait for its repair."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from robrain import Scenario, Team
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.model.zone import ZoneKind, ZoneTable
from robrain.protocol.reasons import DoorShut, PlanLeavesOut
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.maps.drawing import FloorDrawing, Wall
from robrain.sim.traffic.specs import DoorSpec, TrafficSpec

OPENING_S = 6.0
GATE = ZoneTable(name="gate", kind=ZoneKind.DOOR, corners_m=((4.7, 1.95), (5.3, 1.95), (5.3, 3.05), (4.7, 3.05)))
ROOMS = FloorDrawing(size_m=(10.0, 5.0), walls=(Wall((5.0, 0.0), (5.0, 1.9), 0.1), Wall((5.0, 3.1), (5.0, 5.0), 0.1)))


@contextmanager
def explored(*stuck_s: tuple[float, float]) -> Iterator[tuple[LockstepRun, Team]]:
    """Two rooms with a door between them, both known; the robot stands far from it in the second."""
    door = DoorSpec(from_m=(5.0, 1.9), to_m=(5.0, 3.1), opening_s=OPENING_S, name="gate", stuck_s=stuck_s)
    scenario = Scenario(name="rooms", floor=ROOMS, robots=1, near=Point2D(1.5, 2.5), traffic=TrafficSpec(doors=(door,)))
    run = LockstepRun(scenario.world(), planning=PlanningPolicy(zones=(GATE,)))
    try:
        with Team(LockstepTransport(run), by="test") as team:
            team.run_for(60.0, until=lambda: run.nothing_left)
            assert run.explored_fraction > 0.95
            assert team.wait(team.submit("visit", place=(8.5, 1.0))).state is TaskState.DONE
            team.run_for(5.0)
            yield run, team
    finally:
        run.close()


@pytest.mark.slow
def test_a_robot_has_a_door_opened_waits_and_counts_the_time() -> None:
    with explored() as (run, team):
        task, waits, remaining_s = team.submit("visit", place=(1.5, 2.5)), set(), []
        begun_s = run.sim_time_s
        while not team.get(task).state.ended:
            team.run_for(0.2)
            state = team.state("r1")
            waits.add(state.wait_words)
            remaining_s += [state.task.remaining_s] if state.task is not None else []
        assert team.get(task).state is TaskState.DONE
        assert waits == {"", "waits at gate"}
        assert remaining_s[0] > OPENING_S + 6.0 / 0.6
        assert run.sim_time_s - begun_s > 7.0 / 0.6
        team.run_for(10.0)
        [truth] = run.truth.bodies
        assert (truth.body, run.arena.collisions) == ("gate", 0)


@pytest.mark.slow
def test_a_task_behind_a_door_that_fails_is_queued_with_its_name_and_done_after_the_repair() -> None:
    with explored((20.0, 120.0)) as (run, team):
        task, reasons = team.submit("visit", place=(1.5, 2.5)), list[object]()
        while run.sim_time_s < 110.0:
            team.run_for(1.0)
            reasons += [reason] if (reason := team.why(task).reason) not in reasons else []
        record = team.get(task)
        assert (record.state, record.attempts, record.reason) == (TaskState.QUEUED, 0, DoorShut("gate"))
        assert PlanLeavesOut(DoorShut("gate")) in reasons
        assert [zone.is_shut for zone in team.zones()] == [True]
        other = team.submit("visit", place=(2.0, 1.0))  # it is not refused: the door may open again
        assert [team.wait(one, timeout_s=120.0).state for one in (task, other)] == [TaskState.DONE] * 2
        assert run.arena.collisions == 0
