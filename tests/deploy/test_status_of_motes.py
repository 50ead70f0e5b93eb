"""`robrain status` tells how a field of motes is doing that the coordinator keeps alive."""

from robrain.deploy.commands.status_command import TeamStatus, show_status
from robrain.protocol.wire.messages.motes.mote_field_messages import MoteFieldState

FIELD = MoteFieldState(motes=10, dead=1, delivery_ratio=0.968, age_s=5.2, oldest_s=34.4, coverage=0.961, on_duty=3)


def test_state_of_the_field_is_a_line_of_its_own(capsys) -> None:
    show_status(TeamStatus(team="default", coordinator=True, robots=["r1"], mote_field=FIELD))
    assert capsys.readouterr().out.splitlines()[1:] == [
        "  r1 up",
        "  10 motes, 1 dead, 6 off duty; 97 % of the readings arrived, newest 5 s old (oldest 34 s); 96 % covered",
    ]


def test_field_that_nobody_keeps_is_not_told(capsys) -> None:
    show_status(TeamStatus(team="default", coordinator=True, robots=["r1"]))
    assert "motes" not in capsys.readouterr().out
