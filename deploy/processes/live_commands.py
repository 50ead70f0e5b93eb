"""The other live processes: coordinator, dashboard, replay."""

import socket
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import zenoh

from robrain.deploy.processes.dashboard_process import READY_PREFIX
from robrain.deploy.processes.live_process import (
    ANY_PORT,
    LiveStop,
    Place,
    client_session,
    live_endpoint,
    note,
    open_hub,
    open_when_there,
    tell,
)
from robrain.deploy.processes.name_claim import LOOK_PERIOD_S, NameWatch, claim_coordinator
from robrain.deploy.processes.secured_start import check_certificate, check_rights
from robrain.deploy.processes.standing import Standing
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.wire.access.member import MemberRole
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.hub import team_endpoints
from robrain.protocol.wire.keys import check_name
from robrain.protocol.wire.session import listening_at, open_session

if TYPE_CHECKING:  # brings SQLite, which the dashboard does not need
    from robrain.coordinator.journal.journal import Journal

DEFAULT_DASHBOARD_PORT = 8080
NO_ELECTION = Standing()


def coordinator_command(
    place: Place,
    team: str,
    journal: Path | None,
    objective: Objective | None = None,
    planning: Path | None = None,
    rules: Path | None = None,
    standing: Standing = NO_ELECTION,
) -> None:
    """Coordinate a team until Ctrl-C; wait until the endpoint answers.

    Args:
        place: where to connect or listen; without either, the coordinator connects to this machine's hub.
        team: its name.
        journal: file of its tasks; `TEAM.journal` if None.
        objective: planning objective, overriding the file's.
        planning: file with a `[planning]` table.
        rules: file with `[[rules]]`.
        standing: how it comes to lead.

    Raises:
        RobrainError: in one sentence.

    """
    from robrain.coordinator.live import run_coordinator
    from robrain.coordinator.planning.policy import PlanningPolicy
    from robrain.coordinator.rules.rule import Rule

    policy = PlanningPolicy()
    if planning is not None:
        from robrain.deploy.run.planning_file import read_planning  # most coordinators need none and start sooner

        policy = read_planning(planning)
    if objective is not None:
        policy = msgspec.structs.replace(policy, objective=objective)
    kept_rules: tuple[Rule, ...] = ()
    if rules is not None:
        from robrain.deploy.run.rules_file import read_rules

        kept_rules = read_rules(rules)
    should_stop = LiveStop()
    where = place.connect or team_endpoints()
    identity = check_certificate("coordinator", note, [] if place.listen else where, team, MemberRole.COORDINATOR)
    if place.listen:
        session: zenoh.Session | None = open_hub(place.listen[0])[0]
    else:
        session = open_when_there("coordinator", where, should_stop)
    if session is None:
        return
    from robrain.deploy.processes.following import follow_journal

    if identity is not None:
        check_rights("coordinator", note, session, where, identity)

    path = journal if journal is not None else Path(f"{team}.journal")
    stands_by = standing.stands_by
    if standing.witnesses:
        from robrain.deploy.processes.electing import Candidacy, lead_when_elected

        def lead() -> None:
            should_stop.ready()
            tell(f"coordinator: of team {team}; Ctrl-C ends it")

        with closing(session):
            should_stop.ready()
            candidacy = Candidacy(team, path, standing.witnesses, standing.is_forced)
            lead_when_elected(session, candidacy, policy, kept_rules, should_stop, lead, _note)
        return
    with closing(session), claim_coordinator(session, team) as claim, live_endpoint(session, team) as wire:
        if stands_by:
            should_stop.ready()
        if stands_by and not follow_journal(wire, path, claim.info, should_stop, _note):
            return
        if not claim.take(_note, should_stop, stands_by=stands_by):
            return  # before the journal is opened: only one process at a time may write it
        watch = NameWatch(claim, should_stop)
        kept = _open_journal(path, watch, stands_by=stands_by)
        if kept is None:
            watch.check()
            return

        def ready() -> None:
            claim.settle()
            should_stop.ready()
            tell(f"coordinator: of team {team}; Ctrl-C ends it")

        try:
            kept.own()
            run_coordinator(wire, watch, ready, kept, policy, kept_rules)
        finally:
            kept.close()
        watch.check()


def _note(text: str) -> None:
    note(f"coordinator: {text}")


def _open_journal(path: Path, should_stop: Callable[[], bool], *, stands_by: bool) -> "Journal | None":
    """The journal; None if `should_stop` came first.

    A coordinator that hangs has lost its name and still has its journal, until it goes on or is ended. One that stands
    by waits for that: no two ever write the same tasks.

    Raises:
        JournalError: the journal cannot be used; JournalLocked only if it does not stand by.

    """
    from robrain.coordinator.journal.errors import JournalLocked
    from robrain.coordinator.journal.journal import Journal

    is_told = False
    while not should_stop():
        try:
            # One that stands by may not wait inside: it would take that for a hang of its own.
            return Journal(path, lock_timeout_s=0.0 if stands_by else None)
        except JournalLocked as error:
            if not stands_by:
                raise
            if not is_told:
                is_told = True
                _note(f"{error}; waiting until it does not any more")
            time.sleep(LOOK_PERIOD_S)
    return None


def dashboard_command(connect: str | None, team: str, port: int | None, replay: Path | None = None) -> None:
    """Show a team, or a recording, until Ctrl-C."""
    from robrain.coordinator.dashboard import run_dashboard

    if replay is not None:
        show_recording(replay, port)
        return
    should_stop = LiveStop()
    with client_session(connect) as session, live_endpoint(session, team) as wire:

        def ready(url: str) -> None:
            should_stop.ready()
            _tell_url(url)

        run_dashboard(wire, "127.0.0.1", _page_port(port), ready, should_stop)


def show_recording(recording: Path, port: int | None, speed: float = 1.0, start_s: float = 0.0) -> None:
    """Show a recording in a browser page until Ctrl-C; it is paused at `start_s` until *Play* is pressed."""
    from robrain.coordinator.dashboard import ReplaySource, run_dashboard
    from robrain.deploy.fork.fork_child import ForkChild

    should_stop = LiveStop()
    source = ReplaySource(recording, speed=speed, start_s=start_s)
    run_dashboard(source, "127.0.0.1", _page_port(port), _tell_url, should_stop, ForkChild(recording))


def replay_on_wire(
    recording: Path, speed: float, *, loop: bool, connect: list[str], team: str, start_s: float, paused: bool
) -> None:
    """Publish a recording on the wire, once or in a loop."""
    from robrain.coordinator.recording.replay.replay import Replay
    from robrain.deploy.commands.terminal import print_line
    from robrain.deploy.recordings.replay_terminal import replay_terminal
    from robrain.deploy.recordings.replaying import run_replay

    check_name("team", team)
    should_stop = LiveStop()
    session = open_session(mode="client", connect=connect) if connect else open_hub(ANY_PORT)[0]
    with closing(session), live_endpoint(session, team) as wire:
        where = connect or listening_at(session)
        with replay_terminal() as terminal:

            def begin(replay: Replay) -> None:
                print_line(f"{recording} as team {team} at {where[0]}")
                terminal.open(replay)
                if start_s:
                    replay.seek(start_s)
                if paused:
                    replay.player.pause()

            run_replay(
                wire,
                WallClock(),
                recording,
                speed,
                loop=loop,
                should_stop=lambda: should_stop() or terminal.ended,
                on_progress=terminal.show,
                on_open=begin,
            )


def _page_port(port: int | None) -> int:
    """The port that was asked for; else the default if nobody listens on it on loopback, else 0 for a free one."""
    if port is not None:
        return port
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", DEFAULT_DASHBOARD_PORT))
        except OSError:
            return 0
    return DEFAULT_DASHBOARD_PORT


def _tell_url(url: str) -> None:
    tell(f"{READY_PREFIX}{url}")
