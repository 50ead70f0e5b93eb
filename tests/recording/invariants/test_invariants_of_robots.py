"""Nobody is stranded, no wall is crossed, halts are obeyed, energy balances: what keeps and what breaks these."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.recording.invariants.invariant import (
    FloorCharger,
    Invariant,
    InvariantState,
    MissingEvidence,
    Surroundings,
)
from tests.recording.invariants.team_script import RADIUS_M, TeamScript, battery

CHARGER = Surroundings(chargers=(FloorCharger(Point2D(5.0, 5.0), 0.25),))
HALL = Surroundings(clearance_m=lambda x_m, _y_m: max(0.0, abs(x_m - 4.0) - 0.05))
"""A wall of 0.1 m at x = 4."""


def with_robot(**true: Any) -> TeamScript:
    script = TeamScript()
    script.states["r1"] = {}
    script.truths["r1"] = true
    return script


def drive(script: TeamScript, seconds: float, power_w: float = 10.0, **said: Any) -> None:
    """The robot draws power; what it says is renewed before each step of 0.2 s."""
    for _ in range(round(seconds / 0.2)):
        script.truths["r1"]["energy_j"] = script.truths["r1"].get("energy_j", 0.0) + 0.2 * power_w
        script.states["r1"] |= said
        script.pass_time(0.2)


# -- stranded ---------------------------------------------------------------------------------------------------


def test_a_robot_whose_battery_delivers_nothing_is_stranded_and_told_once() -> None:
    script = with_robot(at=(2.0, 5.0))
    drive(script, 3.0, **battery(0.01))
    drive(script, 10.0, power_w=0.0)
    assert script.found(Invariant.NOT_STRANDED, CHARGER) == [
        {"code": "out_of_energy", "robot": "r1", "place": Point2D(2.0, 5.0)}
        | {"charger_m": 3.0, "soc": 0.01, "is_true": True}
    ]
    [breach] = script.ruling(Invariant.NOT_STRANDED, CHARGER).breaches
    assert "r1 has no energy left (1.0 % by its estimate), at x 2.00, y 5.00, 3.00 m from" in breach.text


def test_a_robot_that_is_empty_at_a_charger_is_not_stranded() -> None:
    script = with_robot(at=(5.1, 5.2))
    drive(script, 3.0)
    drive(script, 10.0, power_w=0.0)
    assert script.found(Invariant.NOT_STRANDED, CHARGER) == []
    [found] = script.found(Invariant.NOT_STRANDED)  # where no charger is known
    assert found["charger_m"] is None


def test_without_ground_truth_the_estimate_counts_if_it_is_not_doubted() -> None:
    script = TeamScript()
    script.states["r1"] = {**battery(0.5), "pose": Pose2D(1.0, 2.0, 0.0)}
    script.pass_time(5.0)
    assert script.found(Invariant.NOT_STRANDED) == []
    script.states["r1"] |= battery(0.0)
    script.pass_time(5.0)
    [found] = script.found(Invariant.NOT_STRANDED)
    assert (found["is_true"], found["place"]) == (False, Point2D(1.0, 2.0))
    assert "reports that it has no energy" in script.ruling(Invariant.NOT_STRANDED).breaches[0].text


def test_nobody_is_judged_stranded_without_a_battery_and_truth() -> None:
    script = TeamScript()
    script.states["r1"] = {}
    script.pass_time(1.0)
    for invariant in (Invariant.NOT_STRANDED, Invariant.ENERGY):
        ruling = script.ruling(invariant)
        assert (ruling.state, ruling.missing) == (InvariantState.NOT_JUDGED, MissingEvidence.BATTERIES)


# -- walls ------------------------------------------------------------------------------------------------------


def go(script: TeamScript, *xs_m: float) -> TeamScript:
    for x_m in xs_m:
        script.truths["r1"]["at"] = (x_m, 1.0)
        script.pass_time(0.2)
    return script


def test_a_robot_that_stands_in_a_wall_is_told_once_for_each_time() -> None:
    script = go(with_robot(), 3.0, 3.5, 3.8, 3.85, 3.86, 3.7, 3.5, 3.8)
    found = script.found(Invariant.WALLS, HALL)
    assert [one["code"] for one in found] == ["in_wall", "in_wall"]
    assert found[0]["depth_m"] == pytest.approx(RADIUS_M - 0.15)


@given(st.floats(0.0, 0.55), st.floats(0.1, 0.55))
def test_no_robot_hops_over_a_wall_between_two_truths(start_m: float, step_m: float) -> None:
    xs_m = [3.0 + start_m]
    while xs_m[-1] < 5.0:
        xs_m.append(xs_m[-1] + step_m)
    assert go(with_robot(), *xs_m).found(Invariant.WALLS, HALL)


def test_a_robot_that_is_carried_over_a_wall_does_not_cross_it() -> None:
    assert go(with_robot(), 3.0, 3.1, 5.5, 5.6).found(Invariant.WALLS, HALL) == []


def test_walls_are_judged_only_with_truth_floor_and_radius() -> None:
    assert TeamScript().ruling(Invariant.WALLS, HALL).missing is MissingEvidence.TRUTH
    assert go(with_robot(), 4.0).ruling(Invariant.WALLS).missing is MissingEvidence.FLOOR
    silent = with_robot()
    silent.states.clear()
    ruling = go(silent, 4.0).ruling(Invariant.WALLS, HALL)
    assert (ruling.state, ruling.missing) == (InvariantState.NOT_JUDGED, MissingEvidence.RADIUS)


# -- halts ------------------------------------------------------------------------------------------------------


def halted(script: TeamScript) -> TeamScript:
    """The team is halted, and r1 says so."""
    script.pass_time(1.0)
    script.halt_team()
    script.states["r1"]["halted"] = True
    return script


def test_a_robot_that_stops_obeys() -> None:
    script = halted(with_robot())
    go(script, 1.1, 1.15, 1.18)
    script.pass_time(10.0)
    script.states["r1"]["halted"] = False
    script.resume_team()
    go(script, 1.3, 1.5, 1.9)
    ruling = script.ruling(Invariant.HALTS)
    assert (ruling.state, ruling.cases) == (InvariantState.KEPT, 1)


def test_a_robot_that_creeps_on_does_not_obey_and_is_told_once() -> None:
    script = halted(with_robot())
    go(script, *(1.0 + 0.02 * step for step in range(30)))
    [found] = script.found(Invariant.HALTS)
    assert found["is_true"]
    assert 0.05 < found["moved_m"] < 0.08
    assert found["since_s"] == pytest.approx(1.1)


def test_who_is_pushed_or_carried_obeys() -> None:
    script = halted(with_robot())
    script.pass_time(3.0)
    for count, x_m in enumerate((1.03, 1.06, 1.09, 1.12), 1):
        script.truths["r1"]["collisions"] = count
        go(script, x_m)
    go(script, 6.0, 6.0)
    assert script.found(Invariant.HALTS) == []


def test_who_stands_and_begins_to_drive_is_found() -> None:
    script = halted(with_robot())
    script.pass_time(3.0)
    go(script, *([1.0] * 10), *(1.0 + 0.5 * 0.8 * (0.2 * step) ** 2 for step in range(1, 5)))
    assert script.codes(Invariant.HALTS) == ["moved_halted"]


def test_one_robot_that_is_halted_alone_must_stand_and_another_need_not() -> None:
    script = with_robot()
    script.states["r2"], script.truths["r2"] = {"halted": True}, {}
    for step in range(20):
        script.truths["r1"]["at"] = (1.0 + 0.1 * step, 1.0)
        script.pass_time(0.2)
    assert script.found(Invariant.HALTS) == []
    assert script.ruling(Invariant.HALTS).cases == 1
    for step in range(20):
        script.truths["r2"]["at"] = (1.0 + 0.1 * step, 1.0)
        script.pass_time(0.2)
    assert [(one["code"], one["robot"]) for one in script.found(Invariant.HALTS)] == [("moved_halted", "r2")]


def test_a_robot_in_contact_that_is_not_halted_ignores_the_halt() -> None:
    script = with_robot()
    script.pass_time(1.0)
    script.halt_team("ann")
    script.pass_time(2.0)
    assert script.found(Invariant.HALTS) == []
    script.pass_time(20.0)
    [found] = script.found(Invariant.HALTS)
    assert (found["robot"], found["by"]) == ("r1", "ann")


def test_a_robot_out_of_contact_cannot_ignore_a_halt() -> None:
    script = with_robot()
    script.up = {"r1": False}
    script.pass_time(1.0)
    script.halt_team()
    script.pass_time(20.0)
    assert script.found(Invariant.HALTS) == []


def test_a_robot_that_was_resumed_alone_does_not_ignore_the_halt_of_the_team() -> None:
    script = halted(with_robot())
    script.pass_time(3.0)
    script.states["r1"]["halted"] = False
    script.pass_time(20.0)
    assert script.found(Invariant.HALTS) == []


@pytest.mark.parametrize(("away_s", "is_broken"), [(0.5, True), (3.0, False)])
def test_without_a_coordinator_nobody_tells_a_robot_that_was_away(away_s: float, *, is_broken: bool) -> None:
    script = with_robot()
    script.has_coordinator = False
    script.pass_time(1.0)
    state = script.states.pop("r1")
    script.halt_team()
    script.pass_time(away_s)
    script.states["r1"] = state
    script.pass_time(5.0)
    assert bool(script.found(Invariant.HALTS)) == is_broken


@pytest.mark.parametrize(("moved_m", "is_broken"), [(0.2, False), (1.5, True)])
def test_without_ground_truth_the_poses_before_and_after_a_halt_count(moved_m: float, *, is_broken: bool) -> None:
    script = TeamScript()
    script.states["r1"] = {"pose": Pose2D(1.0, 1.0, 0.0), "pose_covariance": (1e-4, 0.0, 0.0, 0.0, 1e-4, *[0.0] * 4)}
    halted(script).pass_time(5.0)
    script.resume_team()
    script.states["r1"]["halted"] = False
    script.pass_time(0.1)
    script.states["r1"]["pose"] = Pose2D(1.0 + moved_m, 1.0, 0.0)
    script.pass_time(1.0)
    found = script.found(Invariant.HALTS)
    assert bool(found) == is_broken
    assert all(one["code"] == "moved_halted" and not one["is_true"] for one in found)


# -- energy -----------------------------------------------------------------------------------------------------


def discharge(script: TeamScript, seconds: float, from_soc: float, power_w: float = 10.0) -> float:
    """The robot draws power and says so truly; returns its state of charge at the end."""
    for step in range(round(seconds / 0.2)):
        drive(script, 0.2, power_w, **battery(from_soc - step * 0.2 * power_w / 10_000.0))
    return from_soc - seconds * power_w / 10_000.0


def test_energy_that_is_used_charged_and_used_again_balances() -> None:
    script = with_robot(at=(5.0, 5.0))
    soc = discharge(script, 60.0, 0.5)
    for step in range(100):
        drive(script, 0.2, 8.0, **battery(soc + 0.004 * step, charging=True))
    discharge(script, 60.0, soc + 0.4)
    ruling = script.ruling(Invariant.ENERGY, CHARGER)
    assert (ruling.state, ruling.cases) == (InvariantState.KEPT, 1), ruling.breaches


def test_delivered_energy_that_falls_does_not_balance() -> None:
    script = with_robot()
    discharge(script, 10.0, 0.5)
    script.truths["r1"]["energy_j"] = 40.0
    script.pass_time(2.0)
    [found] = script.found(Invariant.ENERGY)
    assert (found["before_j"], found["now_j"]) == (pytest.approx(100.0), 40.0)


def test_a_robot_that_charges_away_from_chargers_does_not_balance() -> None:
    script = with_robot(at=(2.0, 5.0))
    drive(script, 5.0, **battery(0.5, charging=True))
    away = {"code": "charged_away", "robot": "r1", "place": Point2D(2.0, 5.0)}
    assert script.found(Invariant.ENERGY, CHARGER) == [away | {"charger_m": 3.0}]
    assert script.found(Invariant.ENERGY) == []  # where chargers are not known
    assert script.found(Invariant.ENERGY, Surroundings(chargers=())) == [away | {"charger_m": None}]


def test_charge_that_rises_without_a_charger_does_not_balance() -> None:
    script = with_robot()
    soc = discharge(script, 20.0, 0.5)
    drive(script, 2.0, **battery(soc + 0.01))  # within its interval
    assert script.found(Invariant.ENERGY) == []
    drive(script, 2.0, **battery(soc + 0.3))
    assert "charge_rose" in script.codes(Invariant.ENERGY)


def test_an_estimate_that_does_not_fall_with_what_is_used_does_not_balance() -> None:
    script = with_robot()
    for _ in range(600):
        drive(script, 0.2, 10.0, **battery(0.5))
    [found] = script.found(Invariant.ENERGY)
    assert found["delivered_j"] > found["most_j"]


# -- two robots that wait for each other ------------------------------------------------------------------------


def meet(script: TeamScript, one: str, other: str, seconds: float) -> TeamScript:
    script.states |= {"r1": {"waits_for": one}, "r2": {"waits_for": other}}
    script.pass_time(seconds)
    return script


def test_two_robots_that_wait_for_each_other_are_reported_once_for_each_time() -> None:
    script = meet(TeamScript(), "r2", "r1", 45.0)
    assert [(found["code"], found["robot"]) for found in script.found(Invariant.MUTUAL_WAIT)] == [("mutual_wait", "r1")]
    meet(meet(script, "", "r1", 1.0), "r2", "r1", 45.0)
    assert len(script.found(Invariant.MUTUAL_WAIT)) == 2


def test_wait_in_a_line_and_short_or_halted_waits_break_nothing() -> None:
    script = meet(TeamScript(), "r2", "r3", 60.0)
    meet(meet(meet(script, "r2", "r1", 20.0), "r2", "", 1.0), "r2", "r1", 20.0)
    script.states["r2"] = {"waits_for": "r1", "halted": True}
    script.pass_time(60.0)
    assert script.ruling(Invariant.MUTUAL_WAIT).state is InvariantState.KEPT


def test_robot_that_is_silent_waits_for_nobody() -> None:
    script = meet(TeamScript(), "r2", "r1", 20.0)
    del script.states["r2"]
    script.pass_time(60.0)
    meet(script, "r2", "r1", 20.0)
    assert script.found(Invariant.MUTUAL_WAIT) == []
