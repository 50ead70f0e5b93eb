"""`robrain ros2`: a team and ROS 2 nodes on rmw_zenoh."""

from typing import Annotated

import typer

from robrain.deploy.commands.team_options import ConnectOption, TeamOption
from robrain.protocol.wire.keys import DEFAULT_TEAM, check_name

ros2_app = typer.Typer(help="ROS 2 nodes on rmw_zenoh, spoken to without ROS.", no_args_is_help=True)

DomainOption = Annotated[int, typer.Option(help="ROS_DOMAIN_ID of the nodes.")]
RosConnectOption = Annotated[
    str | None,
    typer.Option(help="Endpoint of the nodes' Zenoh router, such as tcp/127.0.0.1:7447; default: that of the team."),
]


@ros2_app.callback()
def options() -> None:
    """ROS 2 nodes on rmw_zenoh, spoken to without ROS."""


@ros2_app.command()
def gateway(
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    ros: RosConnectOption = None,
    domain: DomainOption = 0,
    frame: Annotated[str, typer.Option(help="Name of the arena frame in ROS 2.")] = "map",
) -> None:
    """Show a live team to ROS 2 (map, poses, TF, paths, scans, markers, task events) and take tasks and halts."""
    from robrain.deploy.ros2.gateway_process import gateway_command

    check_name("team", team)
    gateway_command(connect, team, ros, domain, frame)
