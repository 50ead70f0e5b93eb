"""`robrain robot`: take robots out of service, put them back, and rename them."""

from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import OPERATE, CommandApp, ConnectTeam
from robrain.deploy.command_line.options import RobotArgument, place
from robrain.deploy.command_line.output import print_result

robot_app = CommandApp(OPERATE, "robot", "Take robots out of service, put them back, and rename them.")

ReasonOption = Annotated[str, typer.Option(help="Why, for people.")]
GiveBackOption = Annotated[bool, typer.Option("--give-back", help="It gives its task back instead of finishing it.")]
ToOption = Annotated[str, typer.Option("--to", help="It drives there: X,Y in metres, or the name of a zone.")]


@robot_app.team_command()
def hold(
    connect: ConnectTeam,
    robot: RobotArgument,
    reason: ReasonOption = "",
    give_back: GiveBackOption = False,
    to: ToOption = "",
) -> None:
    """Take a robot out of service: it gets no tasks until it is released."""
    where = place("--to", to) if to else None
    connect().hold_robot(robot, reason, gives_back=give_back, place=where)
    print_result(f"{robot}: out of service")


@robot_app.team_command()
def pause(connect: ConnectTeam, robot: RobotArgument, reason: ReasonOption = "") -> None:
    """Stop a robot where it is until it is resumed: it keeps its task. This is no emergency halt."""
    connect().hold_robot(robot, reason, pauses=True)
    print_result(f"{robot}: paused")


@robot_app.team_command()
def retire(connect: ConnectTeam, robot: RobotArgument, reason: ReasonOption = "") -> None:
    """Take a robot out of service for good: the team forgets it once it has left the network."""
    connect().hold_robot(robot, reason, retires=True)
    print_result(f"{robot}: retires")


@robot_app.team_command("release", "resume")
def release(connect: ConnectTeam, robot: RobotArgument) -> None:
    """Put a robot back into service; a paused one continues its task."""
    connect().release_robot(robot)
    print_result(f"{robot}: in service")


@robot_app.team_command()
def rename(
    connect: ConnectTeam,
    robot: RobotArgument,
    label: Annotated[str, typer.Argument(metavar="NAME", help="How people call it; empty to remove that.")],
) -> None:
    """Show a robot under another name; topics, files and tasks keep its own."""
    connect().rename_robot(robot, label)
    print_result(f"{robot}: {f'called {label}' if label else 'has no other name'}")
