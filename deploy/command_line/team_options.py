"""What the commands that connect to a team share: options, the client, and how they print."""

import sys
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from robrain.client.team import Team

ConnectOption = Annotated[
    str | None,
    typer.Option(help="Endpoint of the team, tcp/HOST:PORT; default: $ROBRAIN_CONNECT, else this machine's hub."),
]
TeamOption = Annotated[str, typer.Option(help="Name of the team.")]
RobotArgument = Annotated[str, typer.Argument(help="Name of a robot.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]


class WireFormat(StrEnum):
    """How `robrain wire` prints the wire."""

    MARKDOWN = "markdown"
    JSONSCHEMA = "jsonschema"


def connect_team(connect: str | None, team: str) -> "Team":
    """The team; use it in a `with` block."""
    from robrain.client.team import Team

    return Team.connect(connect, team=team)


def print_json(value: object) -> None:
    """Anything that has a place on the wire, as one line of JSON."""
    import msgspec

    from robrain.protocol.safe_text import safe_json

    sys.stdout.write(safe_json(msgspec.json.encode(value, enc_hook=str)) + "\n")
    sys.stdout.flush()


def say(text: str) -> None:
    """One line on stdout, at once; the lines of a longer text are indented."""
    from robrain.protocol.safe_text import safe_lines

    sys.stdout.write(safe_lines(text, "  ") + "\n")
    sys.stdout.flush()
