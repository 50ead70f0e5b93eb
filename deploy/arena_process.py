"""`robrain arena`: the simulator in real time."""

from contextlib import ExitStack
from pathlib import Path

from robrain.deploy.forwarders import addresses, open_forwarders, said
from robrain.deploy.live_process import LiveStop, live_endpoint, session_of, tell
from robrain.deploy.robot_files import write_robot_files
from robrain.deploy.terminal import say
from robrain.protocol.model.warm_up import warm_up
from robrain.protocol.wire.session import listening_at
from robrain.sim.live_arena import run_arena
from robrain.sim.scenario import Scenario

DEFAULT_LISTEN = "tcp/127.0.0.1:7447"
"""Zenoh's own port, on loopback only."""


def arena_command(
    scenario: Scenario, connect: list[str], listen: str | None, team: str, robot_files: Path | None
) -> None:
    """Simulate a scenario until Ctrl-C."""
    world = scenario.world()
    warm_up()
    should_stop = LiveStop()
    with (
        session_of(connect, listen or DEFAULT_LISTEN) as session,
        live_endpoint(session, team) as wire,
        ExitStack() as closing,
    ):
        where = connect or listening_at(session)
        forwarders = open_forwarders(wire, [robot.name for robot in world.robots], closing)
        listening = addresses(forwarders)
        if robot_files is not None:
            robot_files.mkdir(parents=True, exist_ok=True)
            for path in write_robot_files(world, robot_files, team=team, connect=where[0], forwarders=listening):
                say(f"robrain agent {path}")
        arena = world.arena(wire)
        try:
            names = ", ".join(robot.name for robot in world.robots)
            for robot, address in listening.items():
                tell(said(robot, address))
            tell(f"arena: {scenario.name} at {', '.join(where)}, robots {names}; Ctrl-C ends it")
            run_arena(arena, should_stop, forwarders)
        finally:
            arena.close()
