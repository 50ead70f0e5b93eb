"""`robrain status`: one line for each robot, each reason once, and robots that have gone."""

import pytest

from robrain.deploy.machine.team_checks import check_robot
from robrain.deploy.supervision.team_status import RobotCondition, RobotStatus, TeamStatus, robot_status, show_status
from robrain.protocol.messages.motes.mote_messages import MoteFieldState
from robrain.protocol.messages.robots.robot_messages import BatteryState, PluginFault, RobotState, TaskStatus
from robrain.protocol.messages.robots.witness_messages import Lead
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import TaskState

FIELD = MoteFieldState(motes=10, dead=1, delivery_ratio=0.968, age_s=5.2, oldest_s=34.4, coverage=0.961, on_duty=3)
UP = [robot_status("r1", RobotState(robot="r1"))]
BATTERY = BatteryState(voltage_v=12.0, current_a=1.0, temperature_c=20.0, soc=0.87, remaining_j=1.0)
FAULTS = [PluginFault(plugin=name, why="Traceback:\nOSError: no bus") for name in ("mocdevice", "driver")]


def _shown(capsys: pytest.CaptureFixture[str], *statuses: RobotStatus) -> list[str]:
    show_status(TeamStatus(team="default", coordinator=True, robots=["r1"], statuses=list(statuses)))
    return [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]


def test_robot_has_one_line_with_battery_place_and_task(capsys: pytest.CaptureFixture[str]) -> None:
    task = TaskStatus(id="visit-3", epoch=1, state=TaskState.RUNNING)
    state = RobotState(robot="r1", battery=BATTERY, pose=Pose2D(3.24, -4.0, 0.0), task=task)
    status = robot_status("r1", state)
    assert (status.soc, status.place, status.task) == (0.87, Point2D(3.24, -4.0), "visit-3")
    assert _shown(capsys, status) == [
        "team default: coordinator up",
        "robot state battery place task plugins out",
        "r1 up 87% (3.2, -4.0) visit-3 –",
    ]


def test_ended_task_is_not_shown_and_a_lost_robot_has_no_place() -> None:
    task = TaskStatus(id="visit-3", epoch=1, state=TaskState.DONE)
    status = robot_status("r1", RobotState(robot="r1", pose=Pose2D(1.0, 1.0, 0.0), lost="bumped", task=task))
    assert (status.task, status.place) == ("", None)


def test_one_reason_is_printed_once_for_all_robots_and_plugins(capsys: pytest.CaptureFixture[str]) -> None:
    statuses = [robot_status(name, RobotState(robot=name, faulted=FAULTS)) for name in ("r1", "r2")]
    lines = _shown(capsys, *statuses)
    assert lines[2:] == [
        "r1 faulted – – – 2",
        "r2 faulted – – – 2",
        "r1, r2: mocdevice, driver do not run: OSError: no bus",
    ]


def test_robot_that_has_gone_is_shown_with_its_last_task(capsys: pytest.CaptureFixture[str]) -> None:
    gone = RobotStatus(robot="r2", condition=RobotCondition.GONE, task="visit-3", silent_s=400.0)
    assert "r2 gone 7 min – – visit-3 –" in _shown(capsys, *UP, gone)


def test_state_of_the_field_is_a_line_of_its_own(capsys) -> None:
    show_status(TeamStatus(team="default", coordinator=True, robots=["r1"], statuses=UP, mote_field=FIELD))
    assert capsys.readouterr().out.splitlines()[3:] == [
        "10 motes, 1 dead, 6 off duty; 97 % of the readings arrived, newest 5 s old (oldest 34 s); 96 % covered"
    ]


@pytest.mark.parametrize(
    ("state", "condition", "why"),
    [
        (None, RobotCondition.SILENT, "no state published for 1 s"),
        (RobotState(robot="r1"), RobotCondition.UP, ""),
        (RobotState(robot="r1", halted=True, halted_by=["ann", "bob"]), RobotCondition.HALTED, "halted by ann, bob"),
        (
            RobotState(robot="r1", halted=True, not_halted=["driver"], lost="bumped"),
            RobotCondition.HALTED,
            "halted by the team; not stopped: driver",
        ),
        (RobotState(robot="r1", lost="bumped", faulted=FAULTS), RobotCondition.FAULTED, ""),
        (RobotState(robot="r1", lost="bumped"), RobotCondition.LOST, "lost: bumped"),
    ],
)
def test_each_robot_is_shown_as_it_is(state: RobotState | None, condition: RobotCondition, why: str) -> None:
    status = robot_status("r1", state)
    assert (status.condition, status.why) == (condition, why)


def test_who_elected_the_coordinator_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    lead = Lead(election=4, journal="a", received=2, witnesses=["r1", "r2", "r3"])
    show_status(TeamStatus(team="default", coordinator=True, robots=["r1"], statuses=UP, lead=lead))
    assert "the coordinator leads by election 4: 2 of 3 witnesses hear it" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("state", "ok", "sentence"),
    [
        (RobotState(robot="r1"), True, "r1: up"),
        (RobotState(robot="r1", halted=True, halted_by=["ann"]), True, "r1: halted by ann"),
        (RobotState(robot="r1", faulted=FAULTS), False, "r1: mocdevice, driver do not run: OSError: no bus"),
        (RobotState(robot="r1", lost="bumped"), False, "r1: lost: bumped"),
        (None, False, "r1: no state published for 1 s"),
    ],
)
def test_doctor_checks_robots_that_run(state: RobotState | None, ok: bool, sentence: str) -> None:
    check = check_robot(robot_status("r1", state))
    assert (check.ok, check.sentence, bool(check.remedy)) == (ok, sentence, not ok)
