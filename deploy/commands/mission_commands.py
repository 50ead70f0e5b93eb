"""`robrain mission`: start, list and cancel missions of a running team."""

from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import OPERATE, CommandApp, ConnectTeam, Shown
from robrain.deploy.tasks.task_files import values_set
from robrain.protocol.messages.tasks.mission_messages import MissionStatus, StepState

mission_app = CommandApp(OPERATE, "mission", "Start, list and cancel missions: sets of tasks in order.")


@mission_app.team_command()
def start(
    connect: ConnectTeam,
    mission: Annotated[str, typer.Argument(metavar="MISSION", help="Its name among the [[missions]] of the team.")],
    parameters: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A parameter of the mission, as JSON; may be repeated."),
    ] = None,
    mission_id: Annotated[str | None, typer.Option("--id", help="Name of what is started; default: a new one.")] = None,
) -> Shown:
    """Start a mission."""
    values = values_set(parameters or [])
    status = connect().start_mission(mission, id=mission_id, parameters=values)
    return status, [_line_of(status)]


@mission_app.team_command("list")
def list_missions(connect: ConnectTeam) -> Shown:
    """List the missions that are open, and the last that ended, with their steps."""
    found = connect().missions()
    lines = [] if found else ["no mission was started"]
    for one in found:
        lines.append(_line_of(one))
        for step in one.steps:
            task, why = (f" ({text})" if text else "" for text in (step.task, step.why))
            lines.append(f"  {step.name}: {step.state}{task}{why}")
    return found, lines


@mission_app.team_command()
def cancel(
    connect: ConnectTeam,
    mission_id: Annotated[str, typer.Argument(metavar="ID", help="Name of the started mission.")],
    reason: Annotated[str, typer.Option(help="Reason, for the record.")] = "",
) -> Shown:
    """Cancel a mission and its tasks."""
    status = connect().cancel_mission(mission_id, reason)
    return status, [_line_of(status)]


def _line_of(one: MissionStatus) -> str:
    ended = sum(step.state in (StepState.DONE, StepState.SKIPPED) for step in one.steps)
    at = f" at {', '.join(one.at)}" if one.at else ""
    return f"{one.id}: {one.state}{at}, {ended} of {len(one.steps)} steps{f': {one.why}' if one.why else ''}"
