"""Options shared by the `robrain task` commands, and their output."""

from typing import Annotated, Any

import typer

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON on stdout and nothing else.")]
IdArgument = Annotated[str, typer.Argument(metavar="ID", help="Name of the task.")]


def line_of(record: Any) -> str:
    """A task and its state."""
    return f"{record.task.id}: {text_of(record)}"


def text_of(change: Any) -> str:
    """A task's state, robot and reason."""
    at = f" at {change.robot}" if change.robot else ""
    return f"{change.state.replace('_', ' ')}{at}{f': {change.why}' if change.why else ''}"


def show_table(records: list[Any]) -> None:
    """Tasks as a table."""
    from rich.table import Table

    from robrain.deploy.command_line.terminal import results
    from robrain.protocol.safe_text import safe_lines

    table = Table(box=None, pad_edge=False)
    for heading in ("task", "kind", "state", "robot", "priority", "by", "why"):
        table.add_column(heading, overflow="fold")
    for record in records:
        task = record.task
        row = (task.id, task.kind, record.state, record.robot, f"{task.priority:g}", record.by, record.why)
        table.add_row(*map(safe_lines, row))
    results().print(table)
