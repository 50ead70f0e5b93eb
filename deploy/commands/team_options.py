"""Options shared by the commands that connect to a team."""

from enum import StrEnum
from typing import Annotated

import typer

ConnectOption = Annotated[
    str | None,
    typer.Option(help="Endpoint of the team, tcp/HOST:PORT; default: $ROBRAIN_CONNECT, else this machine's hub."),
]
TeamOption = Annotated[str, typer.Option(help="Name of the team.")]
RobotArgument = Annotated[str, typer.Argument(help="Name of a running robot.")]


class WireFormat(StrEnum):
    """How `robrain wire` prints the wire."""

    MARKDOWN = "markdown"
    JSONSCHEMA = "jsonschema"
    ASYNCAPI = "asyncapi"
