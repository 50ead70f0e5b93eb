"""The invariants of real lockstep runs: all are kept, and a bug that is planted in the product is found.

Each planted bug replaces a function of the product for one run; the same run without it keeps every invariant.
"""

from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from robrain.agent.host.robot_halts import RobotHalts
from robrain.agent.robot_tasks import RobotTasks
from robrain.client.team import Team
from robrain.coordinator.team.roster import Roster
from robrain.deploy.recordings.surroundings import surroundings_of
from robrain.plugins.device.mocdevice.mocdevice import MocDevice
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.zone import Zone, ZoneKind
from robrain.recording.invariants.invariant import Invariant, InvariantState, Ruling
from robrain.recording.invariants.judging import Judging
from robrain.sim.firmware import motor_controller
from robrain.sim.firmware.battery import BatterySpec
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.chargers import ChargerSpec

pytestmark = pytest.mark.slow

SMALL = Scenario.builtin("arena_small").replace(motes=0)
CORNER = Zone(name="corner", kind=ZoneKind.KEEP_OUT, corners_m=((8.0, 0.3), (8.7, 0.3), (8.7, 0.9)))
WITH_CHARGER = SMALL.replace(chargers=(ChargerSpec(place_m=(0.6, 5.4)),))


def judged(script: Callable[[Team], object], scenario: Scenario = SMALL) -> dict[Invariant, Ruling]:
    """How the invariants of a run stand that a script has run."""
    judging = Judging(surroundings_of(scenario))
    with scenario.team(seed=3) as team:
        team.transport.run.follow(judging.receive)  # type: ignore[attr-defined]
        team.change_zones(CORNER)
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


def test_a_robot_that_keeps_its_task_after_the_lease_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RobotTasks, "check_lease", lambda *_: None)
    [one] = only(judged(cut_off), "task_at_two")
    assert (one["task"], one["robots"]) == ("long", ("r1", "r2"))


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
