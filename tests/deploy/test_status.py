"""`robrain status`: one line for each robot, each reason once, and robots that have gone."""

import msgspec
import pytest

from robrain.deploy.machine.team_checks import check_robot
from robrain.deploy.supervision.team_status import RobotCondition, RobotStatus, TeamStatus, robot_status, show_status
from robrain.protocol.messages.robots.robot_messages import PluginFault, RobotState
from robrain.protocol.messages.team.service_messages import RobotLabel

UP = [robot_status("r1", RobotState(robot="r1"))]
FAULTS = [PluginFault(plugin=name, why="Traceback:\nOSError: no bus") for name in ("mocdevice", "driver")]


def _shown(capsys: pytest.CaptureFixture[str], *statuses: RobotStatus) -> list[str]:
    show_status(TeamStatus(team="default", coordinator=True, robots=["r1"], statuses=list(statuses)))
    return [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]


def test_one_reason_is_printed_once_for_all_robots_and_plugins(capsys: pytest.CaptureFixture[str]) -> None:
    statuses = [robot_status(name, RobotState(robot=name, faulted=FAULTS)) for name in ("r1", "r2")]
    lines = _shown(capsys, *statuses)
    assert lines[2:] == [
        "r1 faulted – – – 2",
        "r2 faulted – – – 2",
        "r1, r2: mocdevice, driver do not run: OSError: no bus",
    ]


def test_a_renamed_robot_is_shown_by_both_names(capsys: pytest.CaptureFixture[str]) -> None:
    renamed = msgspec.structs.replace(UP[0], label=RobotLabel("Picker", "ann"))
    assert _shown(capsys, renamed)[2].startswith("Picker (r1) up")


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
