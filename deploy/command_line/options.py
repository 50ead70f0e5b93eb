"""Common options of commands, their parsing, and the printing of results; light, as every command loads it."""

import math
import os
import re
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robrain.deploy.errors import UsageError

if TYPE_CHECKING:
    from robrain.client.team import Team


ConnectOption = Annotated[
    str | None,
    typer.Option(help="Endpoint of the team, tcp/HOST:PORT; default: $ROBRAIN_CONNECT, else this machine's hub."),
]
TeamOption = Annotated[str, typer.Option(help="Name of the team.")]
RobotArgument = Annotated[str, typer.Argument(help="Name of a robot.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON on stdout and nothing else.")]


class WireFormat(StrEnum):
    """Output formats of `robrain wire`."""

    MARKDOWN = "markdown"
    JSONSCHEMA = "jsonschema"


def connect_team(connect: str | None, team: str) -> "Team":
    """The team; use it in a `with` block."""
    from robrain.client.team import Team

    return Team.connect(connect, team=team)


RecordOption = Annotated[Path | None, typer.Option(help="Record to this new MCAP file.")]
ListenOption = Annotated[str | None, typer.Option(help="Endpoint to listen on, such as tcp/127.0.0.1:7447.")]
RulesOption = Annotated[
    Path | None, typer.Option(help="TOML file with [[rules]] that create tasks, and with [[missions]].")
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


def point(option: str, text: str) -> tuple[float, float]:
    """`3,4` as x and y, metres (UsageError naming the option)."""
    try:
        x_m, y_m = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"{option} {text}: expected X,Y in metres, such as 3,4.5") from error
    if not (math.isfinite(x_m) and math.isfinite(y_m)):
        raise UsageError(f"expected a finite {option}, got {text}")
    return x_m, y_m


def place(option: str, text: str) -> list[float] | str:
    """`3,4` as x and y, metres; the name of a zone as it is (UsageError naming the option)."""
    return text if text[:1].isalpha() and "," not in text else [*point(option, text)]


def above_zero(option: str, value: float | None) -> float | None:
    """A number that must be above 0, if it is given (UsageError if it is not)."""
    if value is not None and not value > 0:
        raise UsageError(f"{option} {value:g}: expected a number above 0")
    return value


ScenarioArgument = Annotated[
    str | None, typer.Argument(help="A built-in name (depot), a scenario .toml file, or a map.yaml.")
]
MapOption = Annotated[
    Path | None, typer.Option("--map", help="A map.yaml in the ROS map_server format instead of a scenario.")
]
KnownOption = Annotated[
    bool,
    typer.Option(
        "--known",
        help="The team knows the floor and does not explore it. With a SCENARIO it knows the --map, which may also be "
        "the recording of an earlier run.",
    ),
]
RobotsOption = Annotated[int | None, typer.Option(help="Number of robots.")]
MotesOption = Annotated[int | None, typer.Option(help="Number of sensor motes.")]
SeedOption = Annotated[int | None, typer.Option(help="Seed of all random numbers.")]
NearOption = Annotated[
    str | None, typer.Option(help="X,Y in metres, around which the robots start; default: as the scenario says.")
]
IdleOption = Annotated[
    bool, typer.Option("--idle", help="The team explores only if a task tells it to: for hands and scripts.")
]
UntilOption = Annotated[str | None, typer.Option(help="Stop when this share is explored, such as explored=0.95.")]
TimeLimitOption = Annotated[float | None, typer.Option(help="Stop after this many simulated seconds.")]


def new_recording(path: Path | None) -> Path | None:
    """A path to record to, which must not exist yet: a recording is never overwritten (UsageError)."""
    if path is not None and path.exists():
        raise UsageError(f"--record {path}: it exists already; give another name or move it away")
    return path


def make_folder(folder: Path) -> None:
    """Make a folder for a command's output, unless it exists (UsageError if it cannot be made)."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(
            f"{folder.absolute()} cannot be made: {error.strerror}; run robrain in another folder"
        ) from error


def write_file(path: Path, data: bytes, mode: int = 0o600) -> None:
    """Write a file in one step, and onto the disk: a reader sees the old or the new one."""
    new = path.with_name(f".{path.name}.new")
    new.unlink(missing_ok=True)
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    new.chmod(mode)
    new.replace(path)


def next_file(folder: Path, name: str, suffix: str = ".mcap") -> Path:
    """`folder/name-N.mcap` with the number after the highest there is; creates the folder.

    Parts of split recordings count, also if their first part was removed. UsageError if the folder cannot be made.
    """
    make_folder(folder)
    numbered = re.compile(rf"{re.escape(name)}-(\d+)(_\w+)?{re.escape(suffix)}.*")
    found = [numbered.fullmatch(path.name) for path in folder.iterdir()]
    return folder / f"{name}-{1 + max((int(match[1]) for match in found if match), default=0)}{suffix}"
