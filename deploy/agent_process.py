"""`robrain agent`: one robot. Needs the plain install only."""

from pathlib import Path

import msgspec

from robrain.agent.host import AgentHost
from robrain.agent.live import run_agent
from robrain.agent.robot_file import read_robot_file
from robrain.deploy.live_process import LiveStop, endpoints, tell
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.keys import check_name
from robrain.protocol.wire.session import open_session


def agent_command(robot: Path, connect: str | None, team: str | None) -> None:
    """Run one robot until Ctrl-C."""
    robot_file = read_robot_file(robot)
    table, settings = robot_file.robot, robot_file.zenoh
    if team is not None:
        table = msgspec.structs.replace(table, team=check_name("team", team))
    given = endpoints(connect) if connect is not None or not (settings.connect or settings.listen) else settings.connect
    robot_file = msgspec.structs.replace(robot_file, robot=table)
    should_stop = LiveStop()
    session = open_session(mode=settings.mode, connect=given, listen=settings.listen)
    try:
        host = AgentHost(robot_file, robot.parent, session, WallClock(), Drive.LIVE)

        def tell_plugins() -> None:
            left_out = [f"{tag.name} ({tag.why})" for tag in host.manager.tags.values() if tag.why]
            tell(f"agent: {host.name} is up with {len(host.manager.tags) - len(left_out)} plugins")
            for text in left_out:
                tell(f"agent: {host.name} without {text}")

        run_agent(host, should_stop, tell_plugins)
    finally:
        session.close()
