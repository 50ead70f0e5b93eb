"""The commands that are one live process each: arena, agent, coordinator, dashboard, replay, status."""

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import msgspec
import zenoh

from robrain.agent.host import AgentHost
from robrain.agent.live import run_agent
from robrain.agent.robot_file import read_robot_file
from robrain.deploy.children import Children, LiveStop
from robrain.deploy.dashboard_process import READY_PREFIX, start_dashboard
from robrain.deploy.errors import UsageError
from robrain.deploy.options import endpoints
from robrain.deploy.team_found import TeamFound
from robrain.deploy.terminal import replay_display, say
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.errors import NobodyThere
from robrain.protocol.wire.keys import check_name
from robrain.protocol.wire.session import listening_at, open_session
from robrain.protocol.wire.topics import COORDINATOR_ALIVE, ROBOT_ALIVE
from robrain.sim.scenario import Scenario

DEFAULT_LISTEN = "tcp/127.0.0.1:7447"
"""Zenoh's own port, on loopback only."""
DEFAULT_DASHBOARD_PORT = 8080
GATHER_S = 0.5


def arena_command(
    scenario: Scenario, connect: list[str], listen: str | None, team: str, robot_files: Path | None
) -> None:
    """Simulate a scenario until Ctrl-C."""
    from robrain.deploy.robot_files import write_robot_files
    from robrain.protocol.model.warm_up import warm_up
    from robrain.sim.arena import Arena
    from robrain.sim.live_arena import run_arena

    world = scenario.world()
    warm_up()
    should_stop = LiveStop()
    with _session(connect, listen) as session, _endpoint(session, team) as wire:
        where = connect or listening_at(session)
        if robot_files is not None:
            robot_files.mkdir(parents=True, exist_ok=True)
            for path in write_robot_files(world, robot_files, team=team, connect=where[0]):
                say(f"robrain agent {path}")
        arena = Arena(world.plan, world.robots, world.motes, wire, world.arena_rng())
        try:
            names = ", ".join(robot.name for robot in world.robots)
            _print(f"arena: {scenario.name} at {', '.join(where)}, robots {names}; Ctrl-C ends it")
            run_arena(arena, should_stop)
        finally:
            arena.close()


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

        def tell() -> None:
            left_out = [f"{tag.name} ({tag.why})" for tag in host.manager.tags.values() if tag.why]
            _print(f"agent: {host.name} is up with {len(host.manager.tags) - len(left_out)} plugins")
            for text in left_out:
                _print(f"agent: {host.name} without {text}")

        run_agent(host, should_stop, tell)
    finally:
        session.close()


def coordinator_command(connect: list[str], listen: str | None, team: str) -> None:
    """Coordinate a team until Ctrl-C."""
    from robrain.coordinator.live import run_coordinator

    should_stop = LiveStop()
    with _session(connect, listen) as session, _endpoint(session, team) as wire:
        run_coordinator(wire, should_stop, lambda: _print(f"coordinator: of team {team}; Ctrl-C ends it"))


def dashboard_command(connect: list[str], team: str, port: int | None) -> None:
    """Show a team until Ctrl-C."""
    from robrain.coordinator.dashboard import run_dashboard
    from robrain.deploy.ports import free_or

    should_stop = LiveStop()
    chosen = port if port is not None else free_or(DEFAULT_DASHBOARD_PORT)
    with _session(connect, None) as session, _endpoint(session, team) as wire:
        run_dashboard(wire, "127.0.0.1", chosen, lambda url: _print(f"{READY_PREFIX}{url}"), should_stop)


def replay_command(
    recording: Path, speed: float, *, loop: bool, dashboard: bool, port: int | None, connect: list[str], team: str
) -> None:
    """Replay a recording; with the dashboard, stay until Ctrl-C."""
    from robrain.deploy.replaying import run_replay

    if speed <= 0:
        raise UsageError(f"--speed {speed:g}: expected a number above 0")
    check_name("team", team)
    should_stop = LiveStop()
    clock = WallClock()
    with _session(connect, "tcp/127.0.0.1:0") as session, Children() as children, _endpoint(session, team) as wire:
        where = connect or listening_at(session)
        say(f"{recording} as team {team} at {where[0]}")
        if dashboard:
            say(f"dashboard: {start_dashboard(children, where[0], team, port)}")
        with replay_display() as show:
            ended = run_replay(wire, clock, recording, speed, loop=loop, should_stop=should_stop, on_progress=show)
        if ended and dashboard:
            say("the end; the dashboard stays open: Ctrl-C ends it")
            while not should_stop():
                time.sleep(0.1)


def status_of(connect: list[str], team: str) -> TeamFound:
    """Who of a team is there.

    Raises:
        NobodyThere: nobody is.

    """
    with _session(connect, None) as session, _endpoint(session, team) as wire:
        robots, coordinator = wire.watch(ROBOT_ALIVE), wire.watch(COORDINATOR_ALIVE)
        time.sleep(GATHER_S)
        names = sorted(change.names["robot"] for change in robots.changes() if change.present)
        has_coordinator = any(change.present for change in coordinator.changes())
    if not names and not has_coordinator:
        raise NobodyThere(f"nobody of team {team} is at {', '.join(connect)}; `robrain up` brings a team up")
    return TeamFound(team=team, coordinator=has_coordinator, robots=names)


@contextmanager
def _session(connect: Sequence[str], listen: str | None) -> Iterator[zenoh.Session]:
    """A client of what is given to connect to, or else a hub that listens."""
    if connect or listen is None:
        session = open_session(mode="client", connect=connect)
    else:
        session = open_session(mode="router", listen=[listen])
    try:
        yield session
    finally:
        session.close()


@contextmanager
def _endpoint(session: zenoh.Session, team: str) -> Iterator[Endpoint]:
    endpoint = Endpoint(session, team, WallClock(), Drive.LIVE)
    try:
        yield endpoint
    finally:
        endpoint.close()


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
