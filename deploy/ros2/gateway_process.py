"""`robrain ros2 gateway`: shows a team to ROS 2, and passes orders from there to it."""

import time
from contextlib import ExitStack, closing

from robrain.client.team import Team
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import LiveStop, live_endpoint, open_when_there, tell
from robrain.deploy.ros2.orders import BY, PATIENCE_S, orders_to
from robrain.deploy.ros2.rclpy_publisher import RclpyPublisher, take_orders
from robrain.deploy.ros2.team_gateway import TeamGateway
from robrain.plugins.device.ros2.link import Ros2Link, environment_domain
from robrain.protocol.wire.hub import team_endpoints

STEP_S = 0.05


def gateway_command(connect: str | None, team: str, domain_id: int | None, frame: str, *, read_only: bool) -> None:
    """Run the gateway until Ctrl-C; wait until the endpoint answers.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        domain_id: ROS domain; None uses $ROS_DOMAIN_ID, else 0.
        frame: name of the team's frame in ROS.
        read_only: take no orders.

    Raises:
        RobrainError: in one sentence.

    """
    should_stop = LiveStop()
    try:
        domain = environment_domain() if domain_id is None else domain_id
    except ValueError as error:
        raise UsageError(str(error)) from error
    session = open_when_there("ros2 gateway", team_endpoints(connect), should_stop)
    if session is None:
        return
    with ExitStack() as closing_all:
        closing_all.enter_context(closing(session))
        wire = closing_all.enter_context(live_endpoint(session, team))
        link = closing_all.enter_context(closing(Ros2Link("robrain_gateway", domain)))
        if not read_only:
            halts = closing_all.enter_context(closing(Ros2Link("robrain_halt", domain)))
            tasks = closing_all.enter_context(closing(Ros2Link("robrain_tasks", domain)))
            teams = [
                closing_all.enter_context(Team.connect(connect, team=team, by=BY, patience_s=PATIENCE_S)) for _ in "th"
            ]
            take_orders(tasks, halts, orders_to(*teams))
        gateway = closing_all.enter_context(closing(TeamGateway(wire, RclpyPublisher(link, frame))))
        should_stop.ready()
        orders = "no orders are taken" if read_only else "orders: /robrain/submit_task, /robrain/halt"
        tell(f"ros2 gateway: team {team} in ROS domain {domain}; {orders}")
        while not should_stop() and not link.failure:
            gateway.step()
            time.sleep(STEP_S)
