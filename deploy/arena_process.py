"""`robrain arena`: the simulator in real time."""

from pathlib import Path

from robrain.deploy.live_process import LiveStop, live_endpoint, session_of, tell
from robrain.deploy.robot_files import write_robot_files
from robrain.deploy.terminal import say
from robrain.protocol.model.warm_up import warm_up
from robrain.protocol.wire.session import listening_at
from robrain.sim.arena import Arena
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
    with session_of(connect, listen or DEFAULT_LISTEN) as session, live_endpoint(session, team) as wire:
        where = connect or listening_at(session)
        if robot_files is not None:
            robot_files.mkdir(parents=True, exist_ok=True)
            for path in write_robot_files(world, robot_files, team=team, connect=where[0]):
                say(f"robrain agent {path}")
        arena = Arena(world.plan, world.robots, world.motes, wire, world.arena_rng())
        try:
            names = ", ".join(robot.name for robot in world.robots)
            tell(f"arena: {scenario.name} at {', '.join(where)}, robots {names}; Ctrl-C ends it")
            run_arena(arena, should_stop)
        finally:
            arena.close()
