"""Options shared by the `robrain task` commands, and their output."""

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from robrain.client.team import Team

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON on stdout and nothing else.")]
IdArgument = Annotated[str, typer.Argument(metavar="ID", help="Name of the task.")]


def connect_team(connect: str | None, team: str) -> "Team":
    """The team; use it in a `with` block."""
    from robrain.client.team import Team

    return Team.connect(connect, team=team)


def line_of(record: Any) -> str:
    """A task and its state."""
    return f"{record.task.id}: {words_of(record)}"


def words_of(change: Any) -> str:
    """A task's state, robot and reason."""
    at = f" at {change.robot}" if change.robot else ""
    return f"{change.state.replace('_', ' ')}{at}{f': {change.why}' if change.why else ''}"


def show_table(records: list[Any]) -> None:
    """Tasks as a table."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from robrain.deploy.commands.plugin_commands import PLAIN_WIDTH

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=PLAIN_WIDTH)
    table = Table(box=None, pad_edge=False)
    for heading in ("task", "kind", "state", "robot", "priority", "by", "why"):
        table.add_column(heading, overflow="fold")
    for record in records:
        task = record.task
        row = (task.id, task.kind, record.state, record.robot, f"{task.priority:g}", record.by, record.why)
        table.add_row(*map(escape, row))
    console.print(table)


def print_json(value: object) -> None:
    """Print a message as one line of JSON."""
    import msgspec

    say(msgspec.json.encode(value).decode())


def say(text: str) -> None:
    """Print one line on stdout, unbuffered."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
