"""Options shared by the commands that connect to a team."""

from typing import Annotated

import typer

ConnectOption = Annotated[
    str | None,
    typer.Option(help="Endpoint of the team, tcp/HOST:PORT; default: $ROBRAIN_CONNECT, else this machine's hub."),
]
TeamOption = Annotated[str, typer.Option(help="Name of the team.")]
RobotArgument = Annotated[str, typer.Argument(help="Name of a running robot.")]
