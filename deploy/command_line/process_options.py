"""Options of the commands that start a team's processes, and how some of them are read."""

from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.errors import UsageError

RecordOption = Annotated[Path | None, typer.Option(help="Record to this new MCAP file.")]
ListenOption = Annotated[str | None, typer.Option(help="Endpoint to listen on, such as tcp/127.0.0.1:7447.")]
RulesOption = Annotated[
    Path | None, typer.Option(help="TOML file with [[rules]], by which tasks are made from what is sensed.")
]
JournalOption = Annotated[
    Path | None,
    typer.Option(
        help="File for the tasks; default: TEAM.journal in this folder; with `up` of a scenario, a new one in runs/."
    ),
]
WitnessesOption = Annotated[
    str | None,
    typer.Option(
        envvar="ROBRAIN_WITNESSES",
        help="Robots, such as r1,r2,r3, that elect one of several coordinators, each with its own journal.",
    ),
]
PortOption = Annotated[int | None, typer.Option("--port", help="Port of the dashboard's page; 0 takes a free one.")]


def until_explored(until: str | None) -> float | None:
    """Read `--until explored=0.95` as a fraction.

    Raises:
        UsageError: it has another form.

    """
    if until is None:
        return None
    key, _, value = until.partition("=")
    try:
        fraction = float(value)
    except ValueError:
        fraction = -1.0
    if key != "explored" or not 0 < fraction <= 1:
        raise UsageError(f"--until {until!r}: expected explored=FRACTION with a fraction above 0 and at most 1")
    return fraction


def above_zero(option: str, value: float | None) -> float | None:
    """A number that must be above 0, if it is given (UsageError if it is not)."""
    if value is not None and not value > 0:
        raise UsageError(f"{option} {value:g}: expected a number above 0")
    return value
