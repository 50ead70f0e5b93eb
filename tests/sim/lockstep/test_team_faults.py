"""Faults of processes, wire, disk and battery in a scenario with the whole stack."""

from itertools import pairwise

import pytest

from robrain import Scenario, ScenarioError
from robrain.protocol.border.border import Border
from robrain.protocol.clock import to_seconds
from robrain.protocol.errors import CallError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.tasks.task_messages import TASK_SUBMIT, TaskSubmission
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import EXPLORE
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from robrain.sim.lockstep.lockstep import LockstepRun

SMALL = Scenario.builtin("arena_small").replace(motes=0)
TASK = Task(id="t1", kind="visit", place=Point2D(7.2, 3.0), service_s=1.0)


class Told:
    """A run with faults, and what robots and coordinator say in it."""

    def __init__(self, *faults: FaultSpec, scenario: Scenario = SMALL) -> None:
        self.run = LockstepRun(scenario.replace(faults=faults).world())
        self.wire = Endpoint(self.run.session, "default", self.run.clock, Drive.LOCKSTEP)
        self._inbox = Inbox(every=True, border=Border())
        self.wire.subscribe(self._inbox, ROBOT_STATE)
        self.wire.subscribe(self._inbox, COORDINATOR_STATE)
        self.said: list[tuple[str, float]] = []
        self.latest: dict[str, object] = {}

    def until(self, time_s: float) -> None:
        while self.run.sim_time_s < time_s - 1e-9:
            self.run.tick()
            for received in self._inbox.drain():
                name = received.names.get("robot", COORDINATOR)
                self.said.append((name, round(to_seconds(self.run.clock.now_ns()), 2)))
                self.latest[name] = received.message

    def silent_s(self, name: str) -> tuple[float, float]:
        """The longest silence: from, until."""
        times = [at_s for one, at_s in self.said if one == name]
        return max(pairwise(times), key=lambda pair: pair[1] - pair[0])

    def state_of(self, task: str) -> TaskState | None:
        record = self.run.coordinator.tasks.find(task)
        return None if record is None else record.state


def fault(kind: FaultKind, robot: str = "r2", at_s: float = 2.0, **options: object) -> FaultSpec:
    return FaultSpec(robot=robot, kind=kind, at_s=at_s, **options)


@pytest.mark.slow
def test_a_killed_agent_is_silent_stands_and_finds_its_place_when_it_is_started_again() -> None:
    told = Told(fault(FaultKind.KILL, until_s=5.0))
    told.until(2.0)
    assert [host.name for host in told.run.hosts] == ["r1"]
    assert not len(told.run.arena._robots[1].bus.pending)  # nobody has told the wheels to stop
    told.until(3.0)
    stood = told.run.arena.bodies[1].pose
    told.until(5.0)
    assert told.run.arena.bodies[1].pose.distance_m(stood) < 0.02
    told.until(5.04)
    assert [host.board.lost for host in told.run.hosts] == ["", "nobody has said where it starts"]
    told.until(14.0)
    since_s, until_s = told.silent_s("r2")
    assert (since_s, until_s) == (pytest.approx(2.0, abs=0.11), pytest.approx(5.0, abs=0.2))
    (again,) = [host for host in told.run.hosts if host.name == "r2"]
    assert again.board.pose is not None
    assert not again.board.lost
    true = told.run.arena.bodies[1].pose
    assert again.board.pose.distance_m(true) < 0.3
    told.run.close()


@pytest.mark.slow
def test_a_killed_coordinator_goes_on_with_its_tasks() -> None:
    told = Told(fault(FaultKind.KILL, COORDINATOR, until_s=4.0))
    told.until(1.0)
    told.wire.ask(TASK_SUBMIT, TaskSubmission(task=TASK, by="test"))
    first = told.run.coordinator
    told.until(3.0)
    assert not told.run.has_coordinator
    while told.run.sim_time_s < 60.0 and told.state_of("t1") is not TaskState.DONE:
        told.until(told.run.sim_time_s + 1.0)
    assert told.run.coordinator is not first
    assert told.state_of("t1") is TaskState.DONE
    assert told.silent_s(COORDINATOR)[1] == pytest.approx(4.0, abs=0.1)
    told.run.close()


@pytest.mark.slow
def test_a_full_disk_refuses_tasks_until_there_is_room_again() -> None:
    told = Told(fault(FaultKind.DISK_FULL, COORDINATOR, at_s=0.5, until_s=2.0))
    told.until(1.0)
    with pytest.raises(CallError, match="full"):
        told.wire.ask(TASK_SUBMIT, TaskSubmission(task=TASK, by="test"))
    told.until(2.5)
    told.wire.ask(TASK_SUBMIT, TaskSubmission(task=TASK, by="test"))
    assert told.state_of("t1") is not None
    told.run.close()


@pytest.mark.slow
def test_a_drained_battery_has_the_charge_that_is_left_and_one_with_less_keeps_it() -> None:
    told = Told(fault(FaultKind.DRAIN, "r1", 1.0, soc=0.4), fault(FaultKind.DRAIN, "r1", 2.0, soc=0.9))
    told.until(3.0)
    drained, other = (robot.battery.soc for robot in told.run.arena._robots)
    assert drained == pytest.approx(0.4, abs=0.005)
    assert other > 0.95
    told.run.close()


def test_others_may_not_join_a_run_in_which_components_are_cut_off() -> None:
    with pytest.raises(ScenarioError, match="faults: expected a run that no other process can join"):
        SMALL.replace(faults=(fault(FaultKind.KILL),)).run(listen="tcp/127.0.0.1:0", time_limit_s=1.0)


@pytest.mark.slow
def test_an_explored_team_keeps_its_map_and_rests_after_coordinator_and_robot_were_restarted() -> None:
    told = Told(
        FaultSpec(robot=COORDINATOR, kind=FaultKind.KILL, at_s=42.0, until_s=46.0),
        fault(FaultKind.KILL, at_s=43.0, until_s=56.0),
    )
    told.until(41.9)
    assert told.run.nothing_left
    known = told.run.coordinator.team_map.known_area_m2
    told.until(54.0)  # what the robot that is off has mapped is known by the other alone
    assert told.run.coordinator.team_map.known_area_m2 >= known - 0.5
    explored: set[str] = set()
    while told.run.sim_time_s < 56.0:
        told.run.tick()
        explored.update(record.task.id for record in told.run.coordinator.tasks.open if record.task.kind == EXPLORE)
    assert explored == set()
    while told.run.sim_time_s < 70.0 or not told.run.nothing_left:  # the robot that is back may see new floor
        told.run.tick()
        assert told.run.sim_time_s < 90.0
    assert told.run.coordinator.team_map.known_area_m2 >= known - 0.5
    told.run.close()
