"""`robrain robot`: take robots out of service, put them back, and rename them."""

from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import OPERATE
from robrain.deploy.command_line.options import ConnectOption, RobotArgument, TeamOption, connect_team, place
from robrain.deploy.command_line.output import print_result
from robrain.protocol.keys import DEFAULT_TEAM

robot_app = typer.Typer(
    rich_help_panel=OPERATE,
    name="robot",
    help="Take robots out of service, put them back, and rename them.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

ReasonOption = Annotated[str, typer.Option(help="Why, for people.")]
GiveBackOption = Annotated[bool, typer.Option("--give-back", help="It gives its task back instead of finishing it.")]
ToOption = Annotated[str, typer.Option("--to", help="It drives there: X,Y in metres, or the name of a zone.")]


@robot_app.command()
def hold(
    robot: RobotArgument,
    reason: ReasonOption = "",
    give_back: GiveBackOption = False,
    to: ToOption = "",
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
) -> None:
    """Take a robot out of service: it gets no tasks until it is released."""
    with connect_team(connect, team) as client:
        client.hold_robot(robot, reason, gives_back=give_back, place=place("--to", to) if to else None)
    print_result(f"{robot}: out of service")


@robot_app.command()
def pause(
    robot: RobotArgument, reason: ReasonOption = "", connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM
) -> None:
    """Stop a robot where it is until it is resumed: it keeps its task. This is no emergency halt."""
    with connect_team(connect, team) as client:
        client.hold_robot(robot, reason, pauses=True)
    print_result(f"{robot}: paused")


@robot_app.command()
def retire(
    robot: RobotArgument, reason: ReasonOption = "", connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM
) -> None:
    """Take a robot out of service for good: the team forgets it once it has left the network."""
    with connect_team(connect, team) as client:
        client.hold_robot(robot, reason, retires=True)
    print_result(f"{robot}: retires")


@robot_app.command()
@robot_app.command("resume")
def release(robot: RobotArgument, connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM) -> None:
    """Put a robot back into service; a paused one continues its task."""
    with connect_team(connect, team) as client:
        client.release_robot(robot)
    print_result(f"{robot}: in service")


@robot_app.command()
def rename(
    robot: RobotArgument,
    label: Annotated[str, typer.Argument(metavar="NAME", help="How people call it; empty to remove that.")],
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
) -> None:
    """Show a robot under another name; topics, files and tasks keep its own."""
    with connect_team(connect, team) as client:
        client.rename_robot(robot, label)
    print_result(f"{robot}: {f'called {label}' if label else 'has no other name'}")
