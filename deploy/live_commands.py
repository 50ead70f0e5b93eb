"""The other live processes: coordinator, dashboard, replay, status."""

import time
from pathlib import Path

import msgspec

from robrain.deploy.children import Children
from robrain.deploy.dashboard_process import READY_PREFIX, start_dashboard
from robrain.deploy.errors import UsageError
from robrain.deploy.live_process import LiveStop, live_endpoint, session_of, tell
from robrain.deploy.team_found import TeamFound
from robrain.protocol.model.objective import Objective
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.errors import NobodyThere
from robrain.protocol.wire.keys import check_name
from robrain.protocol.wire.session import listening_at
from robrain.protocol.wire.topics import COORDINATOR_ALIVE, ROBOT_ALIVE

DEFAULT_DASHBOARD_PORT = 8080
GATHER_S = 0.5


def coordinator_command(
    connect: list[str],
    listen: str | None,
    team: str,
    journal: Path | None,
    objective: Objective | None = None,
    planning: Path | None = None,
) -> None:
    """Coordinate a team until Ctrl-C.

    Args:
        connect: endpoints of the team.
        listen: an endpoint of its own, if there is none to connect to.
        team: its name.
        journal: file of its tasks; `TEAM.journal` if None.
        objective: what plans are to be good at, whatever the file says.
        planning: file with a `[planning]` table.

    Raises:
        RobrainError: in one sentence.

    """
    from robrain.coordinator.journal.journal import Journal
    from robrain.coordinator.live import run_coordinator
    from robrain.coordinator.planning.policy import PlanningPolicy

    policy = PlanningPolicy()
    if planning is not None:
        from robrain.deploy.planning_file import read_planning  # here: most coordinators read none, and are up sooner

        policy = read_planning(planning)
    if objective is not None:
        policy = msgspec.structs.replace(policy, objective=objective)
    should_stop = LiveStop()
    with session_of(connect, listen) as session, live_endpoint(session, team) as wire:
        kept = Journal(journal if journal is not None else Path(f"{team}.journal"))
        try:
            ready = f"coordinator: of team {team}; Ctrl-C ends it"
            run_coordinator(wire, should_stop, lambda: tell(ready), kept, policy)
        finally:
            kept.close()


def dashboard_command(connect: list[str], team: str, port: int | None, replay: Path | None = None) -> None:
    """Show a team, or a recording, until Ctrl-C."""
    from robrain.coordinator.dashboard import ReplaySource, run_dashboard
    from robrain.deploy.ports import free_or

    should_stop = LiveStop()
    chosen = port if port is not None else free_or(DEFAULT_DASHBOARD_PORT)

    def ready(url: str) -> None:
        tell(f"{READY_PREFIX}{url}")

    if replay is not None:
        run_dashboard(ReplaySource(replay), "127.0.0.1", chosen, ready, should_stop)
        return
    with session_of(connect, None) as session, live_endpoint(session, team) as wire:
        run_dashboard(wire, "127.0.0.1", chosen, ready, should_stop)


def replay_command(
    recording: Path,
    speed: float,
    *,
    loop: bool,
    dashboard: bool,
    port: int | None,
    connect: list[str],
    team: str,
    start_s: float = 0.0,
    paused: bool = False,
) -> None:
    """Replay a recording; with the dashboard, stay until Ctrl-C."""
    from robrain.coordinator.recording.replay import Replay
    from robrain.deploy.replay_terminal import replay_terminal
    from robrain.deploy.replaying import run_replay
    from robrain.deploy.terminal import say

    if speed <= 0:
        raise UsageError(f"--speed {speed:g}: expected a number above 0")
    check_name("team", team)
    should_stop = LiveStop()
    clock = WallClock()
    with (
        session_of(connect, "tcp/127.0.0.1:0") as session,
        Children() as children,
        live_endpoint(session, team) as wire,
    ):
        where = connect or listening_at(session)
        say(f"{recording} as team {team} at {where[0]}")
        if dashboard:
            say(f"dashboard: {start_dashboard(children, where[0], team, port)}")
        with replay_terminal() as terminal:

            def begin(replay: Replay) -> None:
                terminal.open(replay)
                if start_s:
                    replay.seek(start_s)
                if paused:
                    replay.player.pause()

            ended = run_replay(
                wire,
                clock,
                recording,
                speed,
                loop=loop,
                should_stop=lambda: should_stop() or terminal.ended,
                on_progress=terminal.show,
                on_open=begin,
            )
        if ended and dashboard:
            say("the end; the dashboard stays open: Ctrl-C ends it")
            while not should_stop():
                time.sleep(0.1)


def status_of(connect: list[str], team: str) -> TeamFound:
    """Who of a team is there.

    Raises:
        NobodyThere: nobody is.

    """
    with session_of(connect, None) as session, live_endpoint(session, team) as wire:
        robots, coordinator = wire.watch(ROBOT_ALIVE), wire.watch(COORDINATOR_ALIVE)
        time.sleep(GATHER_S)
        names = sorted(change.names["robot"] for change in robots.changes() if change.present)
        has_coordinator = any(change.present for change in coordinator.changes())
    if not names and not has_coordinator:
        raise NobodyThere(f"nobody of team {team} is at {', '.join(connect)}; `robrain up` brings a team up")
    return TeamFound(team=team, coordinator=has_coordinator, robots=names)
