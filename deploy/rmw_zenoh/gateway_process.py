"""The process of `robrain ros2-zenoh`."""

import time
from contextlib import ExitStack, closing

from robrain.client.team import Team
from robrain.deploy.processes.live_process import LiveStop, live_endpoint, open_when_there, tell
from robrain.deploy.rmw_zenoh.gateway import Gateway
from robrain.deploy.rmw_zenoh.orders import TeamOrders
from robrain.protocol.ros2.ros_node import RosNode
from robrain.protocol.wire.hub import team_endpoints

PERIOD_S = 0.05
NODE, BY = "gateway", "ros2"
NAMESPACE = "/robrain"


def gateway_command(connect: str | None, team: str, ros: str | None, domain: int, frame: str) -> None:
    """Show a team to ROS 2 until Ctrl-C; wait until both endpoints answer.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        ros: endpoint of the nodes' Zenoh router; None is that of the team.
        domain: `ROS_DOMAIN_ID` of the nodes.
        frame: name of the arena frame in ROS 2.

    Raises:
        RobrainError: in one sentence.

    """
    should_stop = LiveStop()
    with ExitStack() as stack:
        session = open_when_there("ros2-zenoh", team_endpoints(connect), should_stop)
        if session is None:
            return
        stack.enter_context(closing(session))
        nodes = session
        if ros is not None:
            there = open_when_there("ros2-zenoh", (ros,), should_stop)
            if there is None:
                return
            nodes = stack.enter_context(closing(there))
        wire = stack.enter_context(live_endpoint(session, team))
        orders = stack.enter_context(closing(TeamOrders(lambda: Team.connect(connect, team=team, by=BY), BY)))
        node = RosNode(nodes, NODE, namespace=NAMESPACE, domain=domain, now_ns=wire.clock.now_ns)
        stack.enter_context(closing(node))
        shown = Gateway(wire, node, orders, map_frame=frame)
        tell(f"ros2-zenoh: team {team} is under {NAMESPACE} in domain {domain}; Ctrl-C ends it")
        should_stop.ready()
        while not should_stop():
            shown.step()
            time.sleep(PERIOD_S)
