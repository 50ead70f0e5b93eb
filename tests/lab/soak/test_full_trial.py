"""Fault scripts with the full stack."""

from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from robrain.cli import all_commands
from robrain.deploy.errors import UsageError
from robrain.deploy.recordings.surroundings import surroundings_of_recording
from robrain.lab.soak.fault_script import (
    CancelOrder,
    FaultScript,
    HaltOrder,
    ScriptRadio,
    ScriptRobot,
    TaskInput,
    script_json,
)
from robrain.lab.soak.judge import TeamRule
from robrain.lab.soak.soaking import CONNECTED, draw_full_script, run_full_trial, scenario_of
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.recording.invariants.invariant import Invariant
from robrain.recording.invariants.judging import JUDGES
from robrain.recording.reader.checking import check_recording
from robrain.sim.faults.fault_spec import COORDINATOR, HARDWARE, FaultKind, FaultSpec
from tests.lab.soak.planted import planted

NEAR = Task(id="t1", kind="visit", place=Point2D(7.2, 3.0), service_s=12.0)
CUT_OFF = FaultScript(
    seed=1,
    scenario="arena_small",
    robots=(ScriptRobot(name="r1", place=Point2D(1.0, 1.0)), ScriptRobot(name="r2", place=Point2D(6.0, 3.0))),
    tasks=(TaskInput(at_s=0.5, task=NEAR),),
    faults=(FaultSpec(robot="r2", kind=FaultKind.PARTITION, at_s=4.0, until_s=14.0),),
)
"""r2 is cut off while it is at the only task."""


@pytest.mark.slow
def test_a_robot_that_is_cut_off_leaves_its_task_to_another_and_the_recording_is_judged_alike(tmp_path: Path) -> None:
    file = tmp_path / "trial.mcap"
    verdict = run_full_trial(CUT_OFF, record=file)
    assert (verdict.broken, verdict.done) == ((), 1)
    assert verdict.lost > 100
    checked = check_recording(file, surroundings=surroundings_of_recording(file))
    assert [ruling.broken for ruling in checked.invariants] == [0] * len(JUDGES)


@pytest.mark.slow
@pytest.mark.usefixtures("impatient")
def test_a_lease_that_is_not_kept_is_found() -> None:
    with planted("lease_not_kept"):
        broken = run_full_trial(CUT_OFF).broken
    assert Invariant.TASK_AT_ONE in {one.invariant for one in broken}


@pytest.mark.slow
def test_a_robot_that_charges_does_a_task_that_nobody_else_can_do_as_soon_as_it_has_enough() -> None:
    """Not when its battery is full, half an hour later."""
    script = msgspec.structs.replace(
        CUT_OFF,
        robots=(
            ScriptRobot(name="r1", place=Point2D(4.225, 5.025), soc=0.33),
            ScriptRobot(name="r2", place=Point2D(7.025, 2.825), soc=0.86),
        ),
        chargers=(Point2D(0.625, 0.625), Point2D(5.825, 5.425)),
        tasks=(TaskInput(at_s=1.5, task=Task(id="t6", kind="visit", place=Point2D(1.825, 1.425))),),
        faults=(
            FaultSpec(robot="r2", kind=FaultKind.KILL, at_s=17.3),
            FaultSpec(robot="r1", kind=FaultKind.CAN_SHORTED, at_s=9.1, until_s=11.4),
        ),
        seed=2207,
    )
    verdict = run_full_trial(script)
    assert (verdict.broken, verdict.done) == ((), 1)
    assert verdict.sim_time_s < 180.0


def test_the_robots_of_a_shrunk_script_are_named_anew_with_their_faults() -> None:
    script = msgspec.structs.replace(CUT_OFF, robots=CUT_OFF.robots[1:])
    scenario = scenario_of(script)
    assert [one.robot for one in scenario.faults] == ["r1"]
    assert scenario.world().robots[0].name == "r1"


@pytest.mark.slow
@pytest.mark.usefixtures("impatient")
def test_a_forgotten_cancellation_is_found() -> None:
    killed = FaultSpec(robot=COORDINATOR, kind=FaultKind.KILL, at_s=6.0, until_s=7.0)
    late = msgspec.structs.replace(NEAR, earliest_ns=12_000_000_000)
    script = msgspec.structs.replace(
        CUT_OFF,
        tasks=(TaskInput(at_s=0.5, task=late),),
        cancels=(CancelOrder(at_s=3.0, task="t1"),),
        faults=(killed,),
    )
    assert run_full_trial(script).broken == ()
    with planted("cancelled_forgotten"):
        broken = run_full_trial(script).broken
    assert TeamRule.LOST in {one.invariant for one in broken}


@pytest.mark.slow
def test_halts_of_the_operator_reach_the_team_and_end() -> None:
    script = msgspec.structs.replace(CUT_OFF, faults=(), halts=(HaltOrder(at_s=2.0, until_s=10.0),))
    verdict = run_full_trial(script)
    assert (verdict.broken, verdict.done) == ((), 1)
    assert verdict.sim_time_s > 10.0 + NEAR.service_s  # it was still under way when it was halted


def test_drawn_scripts_differ_by_seed_and_have_faults_of_all_sorts() -> None:
    scripts = [draw_full_script(seed) for seed in range(60)]
    assert scripts == [draw_full_script(seed) for seed in range(60)]
    assert len({script_json(script) for script in scripts}) == 60
    faults = [fault for script in scripts for fault in script.faults]
    kinds = {fault.kind for fault in faults}
    assert kinds >= set(FaultKind) - HARDWARE - {FaultKind.DRAIN}
    assert len(kinds & HARDWARE) == 6
    assert CONNECTED not in {fault.robot for fault in faults if fault.kind is FaultKind.KILL}
    assert {fault.robot for fault in faults if fault.kind is FaultKind.CLOCK_SKEW} == {COORDINATOR}


def robrain(*words: object):
    return CliRunner().invoke(all_commands(), [str(word) for word in words])


@pytest.mark.slow
def test_the_command_runs_scripts_of_the_full_stack_and_one_again_from_its_file(tmp_path) -> None:
    ended = robrain("soak", "--full", "--runs", 1, "--seed", 8, "--jobs", 1, "-o", tmp_path)
    assert ended.exit_code == 0
    assert "1 scripts, 0 broke an invariant; 6 tasks done" in ended.output
    file = tmp_path / "short.json"
    radio = ScriptRadio(range_m=15.0, loss=0.05, delay_s=0.01)
    file.write_bytes(script_json(msgspec.structs.replace(CUT_OFF, tasks=(), faults=(), radio=radio)))
    assert "no invariant broken" in robrain("soak", "--repeat", file).output


def test_full_is_refused_beside_a_script() -> None:
    with pytest.raises(UsageError, match=r"^--full: expected no --repeat"):
        CliRunner().invoke(all_commands(), ["soak", "--full", "--repeat=x.json"], catch_exceptions=False)


def test_some_scripts_have_a_radio_and_their_scenario_has_its_links() -> None:
    scripts = [draw_full_script(seed) for seed in range(1, 41)]
    with_radio = [script for script in scripts if script.radio is not None]
    assert 6 <= len(with_radio) <= 20
    for script in with_radio:
        links = scenario_of(script).links
        assert links is not None
        assert ScriptRadio(range_m=links.range_m, loss=links.loss, delay_s=links.delay_s) == script.radio
    assert scenario_of(CUT_OFF).links is None


@pytest.mark.parametrize("seed", [900113, 900163, 900169, 900229])
def test_a_drawn_cut_names_robots_of_the_script_alone(seed: int) -> None:
    script = draw_full_script(seed)
    names = {robot.name for robot in script.robots}
    assert all(set(fault.side) <= names for fault in script.faults)
    assert scenario_of(script).faults


def test_a_shrunk_script_cuts_off_the_robots_that_it_had() -> None:
    robots = tuple(ScriptRobot(name=name, place=Point2D(x_m, 1.0)) for name, x_m in (("r2", 1.0), ("r3", 6.0)))
    cut = FaultSpec(robot=COORDINATOR, kind=FaultKind.PARTITION, at_s=4.0, until_s=14.0, side=("r3",))
    (told,) = scenario_of(msgspec.structs.replace(CUT_OFF, robots=robots, faults=(cut,))).faults
    assert told.side == ("r2",)
