"""The command line of `robrain bringup`."""

from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import SET_UP, CommandApp
from robrain.deploy.command_line.options import ConnectOption, JsonOption

bringup_app = CommandApp(SET_UP)


@bringup_app.command()
def bringup(
    robot: Annotated[Path, typer.Argument(help="The robot's ROBOT.toml; what is found is written into it.")],
    connect: ConnectOption = None,
    yes: Annotated[bool, typer.Option("--yes", help="Give the default answer to all questions.")] = False,
    air: Annotated[bool, typer.Option(help="Do the steps with the wheels in the air.")] = True,
    floor: Annotated[bool, typer.Option(help="Do the steps on the floor.")] = True,
    rounds: Annotated[
        int, typer.Option(min=0, max=5, help="Squares to the left, and as many to the right; 0 for none.")
    ] = 1,
    measured: Annotated[bool, typer.Option("--measured", help="Measure the ends of squares by hand.")] = False,
    write: Annotated[bool, typer.Option(help="Write what is found into the file.")] = True,
    as_json: JsonOption = False,
) -> None:
    """Check a new robot's wheels, lidar and battery step by step, and calibrate its odometry. The robot moves.

    Exits with 1 if something was wrong, also if the file has been corrected.
    """
    from robrain.deploy.bringup.bring_up import BringUpOptions
    from robrain.deploy.bringup.bringup_command import bringup_command

    wanted = BringUpOptions(air=air, floor=floor, rounds=rounds, measured=measured, write=write)
    if not bringup_command(robot, connect, wanted, yes=yes, as_json=as_json):
        raise typer.Exit(1)
