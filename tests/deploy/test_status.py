"""`robrain status`: how each robot is, and the field of motes that the coordinator keeps alive."""

import pytest

from robrain.deploy.commands.status_command import RobotCondition, TeamStatus, show_status, standing_of
from robrain.protocol.wire.messages.motes.mote_field_messages import MoteFieldState
from robrain.protocol.wire.messages.robots.robot_messages import PluginFault, RobotState
from robrain.protocol.wire.messages.team.witness_messages import Lead

FIELD = MoteFieldState(motes=10, dead=1, delivery_ratio=0.968, age_s=5.2, oldest_s=34.4, coverage=0.961, on_duty=3)
UP = [standing_of("r1", RobotState(robot="r1"))]


def test_state_of_the_field_is_a_line_of_its_own(capsys) -> None:
    show_status(TeamStatus(team="default", coordinator=True, robots=["r1"], standing=UP, mote_field=FIELD))
    assert capsys.readouterr().out.splitlines()[1:] == [
        "  r1 up",
        "  10 motes, 1 dead, 6 off duty; 97 % of the readings arrived, newest 5 s old (oldest 34 s); 96 % covered",
    ]


def test_a_field_that_the_coordinator_leaves_alone_is_not_mentioned(capsys) -> None:
    show_status(TeamStatus(team="default", coordinator=True, robots=["r1"], standing=UP))
    assert "motes" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("state", "condition", "line"),
    [
        (None, RobotCondition.SILENT, "r1 silent: it has published no state for 1 s"),
        (RobotState(robot="r1"), RobotCondition.UP, "r1 up"),
        (
            RobotState(robot="r1", halted=True, halted_by=["ann", "bob"]),
            RobotCondition.HALTED,
            "r1 halted: by ann, bob",
        ),
        (
            RobotState(robot="r1", halted=True, not_halted=["driver"], lost="bumped", faulted=[]),
            RobotCondition.HALTED,
            "r1 halted: by the team; not stopped: driver",
        ),
        (
            RobotState(
                robot="r1", lost="bumped", faulted=[PluginFault(plugin="scan", why="Traceback:\nOSError: gone")]
            ),
            RobotCondition.FAULTED,
            "r1 faulted: scan does not run: OSError: gone",
        ),
        (RobotState(robot="r1", lost="bumped"), RobotCondition.LOST, "r1 lost: bumped"),
    ],
)
def test_each_robot_is_shown_as_it_is(capsys, state: RobotState | None, condition: RobotCondition, line: str) -> None:
    standing = standing_of("r1", state)
    assert standing.condition is condition
    show_status(TeamStatus(team="default", coordinator=False, robots=["r1"], standing=[standing]))
    assert capsys.readouterr().out.splitlines()[1] == f"  {line}"


def test_who_elected_the_coordinator_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    lead = Lead(election=4, journal="a", heard=2, witnesses=["r1", "r2", "r3"])
    show_status(TeamStatus(team="default", coordinator=True, robots=["r1"], standing=UP, lead=lead))
    assert "the coordinator leads by election 4: 2 of 3 witnesses hear it" in capsys.readouterr().out
