"""Fault scripts with the full stack."""

from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from robrain.cli import all_commands
from robrain.deploy.recordings.surroundings import surroundings_of_recording
from robrain.lab.soak.fault_script import FaultScript, ScriptRadio, ScriptRobot, TaskInput, script_json
from robrain.lab.soak.soaking import CONNECTED, draw, draw_full_script, run_full_trial, scenario_of
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


def test_the_robots_of_a_shrunk_script_are_named_anew_with_their_faults() -> None:
    script = msgspec.structs.replace(CUT_OFF, robots=CUT_OFF.robots[1:])
    scenario = scenario_of(script)
    assert [one.robot for one in scenario.faults] == ["r1"]
    assert scenario.world().robots[0].name == "r1"


def test_drawn_scripts_differ_by_seed_and_have_faults_and_radios_of_all_sorts() -> None:
    scripts = [draw_full_script(seed) for seed in range(60)]
    assert scripts == [draw_full_script(seed) for seed in range(60)]
    assert len({script_json(script) for script in scripts}) == 60
    faults = [fault for script in scripts for fault in script.faults]
    kinds = {fault.kind for fault in faults}
    assert kinds >= set(FaultKind) - HARDWARE - {FaultKind.DRAIN}
    assert len(kinds & HARDWARE) == 6
    assert CONNECTED not in {fault.robot for fault in faults if fault.kind is FaultKind.KILL}
    assert {fault.robot for fault in faults if fault.kind is FaultKind.CLOCK_SKEW} == {COORDINATOR}
    for script in scripts:
        names = {robot.name for robot in script.robots}
        assert all(set(fault.side) <= names for fault in script.faults)
    with_radio = [script for script in scripts if script.radio is not None]
    assert 9 <= len(with_radio) <= 30
    links = scenario_of(with_radio[0]).links
    assert links is not None
    assert ScriptRadio(range_m=links.range_m, loss=links.loss, delay_s=links.delay_s) == with_radio[0].radio
    assert scenario_of(CUT_OFF).links is None


def robrain(*words: object):
    return CliRunner().invoke(all_commands(), [str(word) for word in words])


@pytest.mark.slow
def test_the_command_runs_a_script_of_the_full_stack_from_its_file(tmp_path) -> None:
    assert draw(8, is_full=True) == draw_full_script(8)
    file = tmp_path / "short.json"
    radio = ScriptRadio(range_m=15.0, loss=0.05, delay_s=0.01)
    file.write_bytes(script_json(msgspec.structs.replace(CUT_OFF, tasks=(), faults=(), radio=radio)))
    assert "no invariant broken" in robrain("soak", "--repeat", file).output


def test_a_shrunk_script_cuts_off_the_robots_that_it_had() -> None:
    robots = tuple(ScriptRobot(name=name, place=Point2D(x_m, 1.0)) for name, x_m in (("r2", 1.0), ("r3", 6.0)))
    cut = FaultSpec(robot=COORDINATOR, kind=FaultKind.PARTITION, at_s=4.0, until_s=14.0, side=("r3",))
    (told,) = scenario_of(msgspec.structs.replace(CUT_OFF, robots=robots, faults=(cut,))).faults
    assert told.side == ("r2",)
