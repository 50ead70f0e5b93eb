"""`robrain mission`: start, list and cancel missions of a running team."""

from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import OPERATE
from robrain.deploy.command_line.options import ConnectOption, JsonOption, TeamOption, connect_team
from robrain.deploy.command_line.output import print_either
from robrain.deploy.tasks.task_files import values_set
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.tasks.mission_messages import MissionStatus, StepState

mission_app = typer.Typer(
    rich_help_panel=OPERATE,
    name="mission",
    help="Start, list and cancel missions: sets of tasks in order.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@mission_app.command()
def start(
    mission: Annotated[str, typer.Argument(metavar="MISSION", help="Its name among the [[missions]] of the team.")],
    parameters: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A parameter of the mission, as JSON; may be repeated."),
    ] = None,
    mission_id: Annotated[str | None, typer.Option("--id", help="Name of what is started; default: a new one.")] = None,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Start a mission."""
    values = values_set(parameters or [])
    with connect_team(connect, team) as client:
        status = client.start_mission(mission, id=mission_id, parameters=values)
    print_either(status, [_line_of(status)], as_json=as_json)


@mission_app.command("list")
def list_missions(connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM, as_json: JsonOption = False) -> None:
    """List the missions that are open, and the last that ended, with their steps."""
    with connect_team(connect, team) as client:
        found = client.missions()
    lines = [] if found else ["no mission was started"]
    for one in found:
        lines.append(_line_of(one))
        for step in one.steps:
            task, why = (f" ({text})" if text else "" for text in (step.task, step.why))
            lines.append(f"  {step.name}: {step.state}{task}{why}")
    print_either(found, lines, as_json=as_json)


@mission_app.command()
def cancel(
    mission_id: Annotated[str, typer.Argument(metavar="ID", help="Name of the started mission.")],
    reason: Annotated[str, typer.Option(help="Reason, for the record.")] = "",
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Cancel a mission and its tasks."""
    with connect_team(connect, team) as client:
        status = client.cancel_mission(mission_id, reason)
    print_either(status, [_line_of(status)], as_json=as_json)


def _line_of(one: MissionStatus) -> str:
    ended = sum(step.state in (StepState.DONE, StepState.SKIPPED) for step in one.steps)
    at = f" at {', '.join(one.at)}" if one.at else ""
    return f"{one.id}: {one.state}{at}, {ended} of {len(one.steps)} steps{f': {one.why}' if one.why else ''}"
