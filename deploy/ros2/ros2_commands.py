"""`robrain ros2 …`: options."""

from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import CONNECT, CommandApp
from robrain.deploy.command_line.options import ConnectOption, TeamOption
from robrain.deploy.errors import UsageError
from robrain.protocol.keys import DEFAULT_TEAM, check_name

ros2_app = CommandApp(CONNECT, "ros2", "A team and ROS 2.")


@ros2_app.command()
def gateway(
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    domain: Annotated[
        int | None, typer.Option(help="ROS domain; default: $ROS_DOMAIN_ID, else 0.", min=0, max=232)
    ] = None,
    frame: Annotated[str, typer.Option(help="Name of the team's frame in ROS.")] = "map",
    read_only: Annotated[bool, typer.Option("--read-only", help="Take no tasks and no halts from ROS.")] = False,
    zenoh: Annotated[
        bool, typer.Option("--zenoh", help="For nodes on rmw_zenoh: over Zenoh itself, without ROS.")
    ] = False,
    router: Annotated[
        str | None,
        typer.Option(help="With --zenoh: endpoint of the nodes' router, tcp/HOST:PORT; default: the team's."),
    ] = None,
) -> None:
    """Show a team to ROS 2: map, poses, paths, scans, batteries, markers, task events; accept tasks and halts."""
    if router is not None and not zenoh:
        raise UsageError("--router: expected it together with --zenoh")
    from robrain.deploy.ros2.gateway_process import gateway_command

    gateway_command(
        connect,
        check_name("team", team),
        domain_id=domain,
        frame=frame,
        read_only=read_only,
        over_zenoh=zenoh,
        router=router,
    )
