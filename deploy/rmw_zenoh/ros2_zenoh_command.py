"""`robrain ros2-zenoh`: options."""

from typing import Annotated

import typer

from robrain.deploy.commands.team_options import ConnectOption, TeamOption
from robrain.protocol.wire.keys import DEFAULT_TEAM, check_name


def ros2_zenoh(
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    ros: Annotated[
        str | None,
        typer.Option(help="Endpoint of the nodes' Zenoh router, such as tcp/127.0.0.1:7447; default: the team's."),
    ] = None,
    domain: Annotated[int, typer.Option(help="ROS_DOMAIN_ID of the nodes.", min=0, max=232)] = 0,
    frame: Annotated[str, typer.Option(help="Name of the team's frame in ROS.")] = "map",
) -> None:
    """Show a live team to ROS 2 nodes on rmw_zenoh, without ROS; take tasks and halts from there."""
    from robrain.deploy.rmw_zenoh.gateway_process import gateway_command

    check_name("team", team)
    gateway_command(connect, team, ros, domain, frame)
