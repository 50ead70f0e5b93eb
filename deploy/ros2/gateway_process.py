"""`robrain ros2 gateway`: shows a team to ROS 2, by rclpy or over Zenoh, and passes orders from there to it."""

import time
from collections.abc import Callable
from contextlib import ExitStack, closing

import zenoh

from robrain.client.team import Team
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import LiveStop, live_endpoint, open_when_there, tell
from robrain.deploy.ros2.gateway import Gateway
from robrain.deploy.ros2.orders import TeamOrders
from robrain.plugins.device.ros2.parameters import environment_domain
from robrain.protocol.ros2.ros_node import RosNode
from robrain.protocol.ros2.ros_port import RosPort
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.hub import team_endpoints

PERIOD_S = 0.05
NODE, BY, NAMESPACE = "gateway", "ros2", "/robrain"
NAME = "ros2 gateway"
PATIENCE_S = 3.0
"""How long a caller waits for a coordinator that does not answer."""


def gateway_command(
    connect: str | None,
    team: str,
    *,
    domain_id: int | None,
    frame: str,
    read_only: bool,
    over_zenoh: bool,
    router: str | None,
) -> None:
    """Run the gateway until Ctrl-C; wait until the endpoints answer.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        domain_id: ROS domain; None uses $ROS_DOMAIN_ID, else 0.
        frame: name of the team's frame in ROS.
        read_only: take no orders.
        over_zenoh: speak to nodes on rmw_zenoh, without ROS; else by rclpy.
        router: with `over_zenoh`, endpoint of the nodes' Zenoh router; None is that of the team.

    Raises:
        RobrainError: in one sentence.

    """
    should_stop = LiveStop()
    try:
        domain = environment_domain() if domain_id is None else domain_id
    except ValueError as error:
        raise UsageError(str(error)) from error
    with ExitStack() as stack:
        session = open_when_there(NAME, team_endpoints(connect), should_stop)
        if session is None:
            return
        stack.enter_context(closing(session))
        wire = stack.enter_context(live_endpoint(session, team))
        if over_zenoh:
            nodes = session if router is None else open_when_there(NAME, (router,), should_stop)
            if nodes is None:
                return
            stack.enter_context(closing(nodes))
            port, failure = _zenoh_port(nodes, domain, wire)
        else:
            port, failure = _rclpy_port(domain)
        stack.enter_context(closing(port))
        orders = None
        if not read_only:
            orders = stack.enter_context(
                closing(TeamOrders(lambda: Team.connect(connect, team=team, by=BY, patience_s=PATIENCE_S), BY))
            )
        shown = Gateway(wire, port, orders, map_frame=frame)
        should_stop.ready()
        taken = "no orders are taken" if read_only else f"orders: {NAMESPACE}/submit_task, {NAMESPACE}/halt"
        tell(f"{NAME}: team {team} in ROS domain {domain}; {taken}")
        while not should_stop() and not failure():
            shown.step()
            time.sleep(PERIOD_S)


def _zenoh_port(session: zenoh.Session, domain: int, wire: Endpoint) -> tuple[RosPort, Callable[[], str]]:
    return RosNode(session, NODE, namespace=NAMESPACE, domain=domain, now_ns=wire.clock.now_ns), lambda: ""


def _rclpy_port(domain: int) -> tuple[RosPort, Callable[[], str]]:
    from robrain.deploy.ros2.rclpy_port import RclpyPort  # it needs rclpy

    port = RclpyPort(domain, NAMESPACE)
    return port, lambda: port.failure
