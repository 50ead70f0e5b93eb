"""`robrain lead`: the operator's word that no other coordinator leads."""

import os

from robrain.client.team import Team
from robrain.deploy.processes.live_process import tell
from robrain.protocol.model.tasks.halt_latch import OPERATOR


def lead_command(connect: str | None, team: str) -> None:
    """Have the coordinator offer tasks again, and print which silent robots count no more.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.

    Raises:
        RobrainError: no coordinator is there, or a name or endpoint is invalid.

    """
    with Team.connect(connect, team=team, by=f"{OPERATOR}:{os.environ.get('USER') or 'somebody'}") as client:
        left_out = client.lead()
    if left_out:
        tell(f"the coordinator offers tasks again; silent robots that count no more: {', '.join(left_out)}")
    else:
        tell("the coordinator was not holding tasks back")
