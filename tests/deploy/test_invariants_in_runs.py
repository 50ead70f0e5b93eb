"""The invariants of real lockstep runs: all are kept, and a bug that is planted in the product is found.

Each planted bug replaces a function of the product for one run; the same run without it keeps every invariant.
"""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from robrain.agent.host.robot_halts import RobotHalts
from robrain.agent.robot_tasks import RobotTasks
from robrain.client.team import Team
from robrain.coordinator.parts import exploration
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.roster import Roster
from robrain.deploy.recordings.surroundings import surroundings_of
from robrain.plugins.behavior.recharge import RechargeBehavior
from robrain.plugins.device.mocdevice.mocdevice import MocDevice
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.invariants.invariant import Invariant, InvariantState, Ruling
from robrain.recording.invariants.judging import Judging
from robrain.sim.firmware import motor_controller
from robrain.sim.firmware.battery import BatterySpec, SimulatedBattery
from robrain.sim.robot import robot_team
from robrain.sim.robot.robot_body import RobotBodies
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.chargers import ChargerSpec

pytestmark = pytest.mark.slow

SMALL = Scenario.builtin("arena_small").replace(motes=0)
WITH_CHARGER = SMALL.replace(chargers=(ChargerSpec(place_m=(0.6, 5.4)),))


def judged(script: Callable[[Team], object], scenario: Scenario = SMALL) -> dict[Invariant, Ruling]:
    """How the invariants of a run stand that a script has run."""
    judging = Judging(surroundings_of(scenario))
    with scenario.team(seed=3) as team:
        team.transport.run.follow(judging.receive)  # type: ignore[attr-defined]
        script(team)
    return {ruling.invariant: ruling for ruling in judging.finish()}


def found(rulings: dict[Invariant, Ruling]) -> list[dict[str, Any]]:
    """What was found; fails if nothing is judged any more."""
    assert not [ruling for ruling in rulings.values() if ruling.state is InvariantState.NOT_JUDGED]
    return [breach.finding for ruling in rulings.values() for breach in ruling.breaches]


def only(rulings: dict[Invariant, Ruling], code: str) -> list[dict[str, Any]]:
    """The findings, which are all of one kind."""
    all_found = found(rulings)
    assert {one["code"] for one in all_found} == {code}, [b.text for r in rulings.values() for b in r.breaches]
    return all_found


# -- what the runs do -------------------------------------------------------------------------------------------


def visits(team: Team) -> None:
    """Tasks that are done."""
    team.run_for(1.0)
    team.submit("visit", id="door", place=(4.2, 3.0))
    team.submit("visit", id="corner", place=(1.0, 1.0))
    team.wait_all(["door", "corner"])
    team.run_for(3.0)


def halts(team: Team) -> None:
    """A task that a halt interrupts, and that is done in the end."""
    team.run_for(1.0)
    team.submit("visit", id="door", place=(6.0, 3.0), service_s=3.0)
    team.run_for(3.0)
    team.halt()
    team.run_for(4.0)
    team.resume()
    team.run_for(6.0)


def cut_off(team: Team) -> None:
    """The coordinator hears nothing of the robot with the task, and the robot nothing of it."""
    team.run_for(1.0)
    team.submit("visit", id="long", place=(2.0, 2.0), service_s=30.0)
    team.run_for(5.0)
    name = team.get("long").robot
    run = team.transport.run  # type: ignore[attr-defined]
    host = next(host for host in run.hosts if host.name == name)
    roster: Roster = run.coordinator.roster
    note = roster.record_state

    def note_others(state: RobotState, now_ns: int) -> None:
        if state.robot != name:
            note(state, now_ns)

    roster.record_state = note_others  # type: ignore[method-assign]
    host._inbox.drain = list
    team.run_for(10.0)
    assert team.get("long").robot not in ("", name)


def standing(team: Team) -> None:
    """Nothing but time."""
    team.run_for(8.0)


def long_day(team: Team) -> None:
    """Long enough for the small batteries of `weak`."""
    team.run_for(60.0)


def weak(scenario: Scenario) -> Scenario:
    """With batteries for some 45 s."""
    battery = BatterySpec(capacity_wh=0.4, soc_at_start=0.4)
    return scenario.replace(robots=1, hardware=msgspec.structs.replace(scenario.hardware, battery=battery))


RUNS = {
    "visits": (visits, SMALL),
    "halts": (halts, SMALL),
    "cut_off": (cut_off, SMALL),
    "long_day": (long_day, weak(WITH_CHARGER)),
}


@pytest.mark.parametrize("name", RUNS)
def test_a_run_keeps_every_invariant(name: str) -> None:
    script, scenario = RUNS[name]
    rulings = judged(script, scenario)
    assert found(rulings) == []
    assert rulings[Invariant.WALLS].cases > 10
    assert rulings[Invariant.HALTS].cases == (name == "halts")


# -- planted bugs -----------------------------------------------------------------------------------------------


def test_a_coordinator_that_forgets_what_it_queues_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    give_back = TaskBook.give_back

    def forgets(book: TaskBook, task_id: str, *given: Any, **named: Any) -> TaskRecord:
        record = give_back(book, task_id, *given, **named)
        book._open.pop(task_id, None)
        return record

    monkeypatch.setattr(TaskBook, "give_back", forgets)
    [one] = only(judged(halts), "tasks_forgotten")
    assert (one["missing"], one["tasks"]) == (1, ["door"])


def test_a_robot_that_keeps_its_task_after_the_lease_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RobotTasks, "check_lease", lambda *_: None)
    [one] = only(judged(cut_off), "task_at_two")
    assert (one["task"], one["robots"]) == ("long", ("r1", "r2"))


def test_an_end_that_is_told_twice_as_two_changes_and_a_meter_of_energy_that_falls_are_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    take = TaskBook._keep_change

    def tells_twice(book: TaskBook, record: TaskRecord) -> TaskRecord:
        taken = take(book, record)
        if taken.state is TaskState.DONE:
            book._publish(msgspec.structs.replace(taken, change=taken.change + 1).event)
        return taken

    step = SimulatedBattery.step

    def leaks(battery: SimulatedBattery, *given: float) -> None:
        step(battery, *given)
        if battery.delivered_j > 50.0:
            battery.delivered_j -= 20.0

    monkeypatch.setattr(TaskBook, "_keep_change", tells_twice)
    monkeypatch.setattr(SimulatedBattery, "step", leaks)
    told = found(judged(visits))
    assert {one["code"] for one in told} == {"done_again", "delivered_fell"}
    assert {"door", "corner"} <= {one["task"] for one in told if one["code"] == "done_again"}
    assert all(one["now_j"] < one["before_j"] for one in told if one["code"] == "delivered_fell")


def test_a_robot_that_does_not_hear_halts_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    receive = RobotHalts.receive
    monkeypatch.setattr(RobotHalts, "receive", lambda halts: None if halts._robot == "r1" else receive(halts))
    [one] = only(judged(halts), "halt_ignored")
    assert (one["robot"], one["by"]) == ("r1", "script")


def test_a_robot_that_says_to_be_halted_and_rolls_on_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MocDevice, "emergency_halt", lambda _: None)
    monkeypatch.setattr(motor_controller, "WATCHDOG_S", 1000.0)
    told = only(judged(halts), "moved_halted")
    assert all(one["is_true"] and one["moved_m"] > 0.05 for one in told)


def pushed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Something pushes every robot to the east."""
    drive = RobotBodies.drive

    def push(bodies: RobotBodies) -> None:
        drive(bodies)
        for body in bodies.bodies:
            body.body.velocity = (0.4, 0.0)

    monkeypatch.setattr(RobotBodies, "drive", push)


def test_robots_that_are_pushed_against_a_wall_do_not_cross_it(monkeypatch: pytest.MonkeyPatch) -> None:
    pushed(monkeypatch)
    assert found(judged(standing, WITH_CHARGER)) == []


def test_robots_that_go_through_walls_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    pushed(monkeypatch)
    monkeypatch.setattr(robot_team, "add_walls", lambda *_, **__: None)
    told = only(judged(standing, WITH_CHARGER), "in_wall")
    assert {one["robot"] for one in told} == {"r1", "r2"}


def test_a_robot_that_does_not_go_home_to_charge_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RechargeBehavior, "step", lambda _: None)
    monkeypatch.setattr(exploration, "reach_m", lambda *_: math.inf)  # nor does the coordinator count the way home
    [one] = only(judged(long_day, weak(WITH_CHARGER)), "out_of_energy")
    assert one["robot"] == "r1"
