"""`robrain coordinator`: coordinate a team, alone, as the one that stands by, or elected by robots."""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import msgspec
import zenoh

from robrain.coordinator.journal.errors import JournalLocked
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.live import run_coordinator
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.rules.rule import Rule
from robrain.deploy.coordination.electing import ElectedCoordinator
from robrain.deploy.coordination.following import follow_journal
from robrain.deploy.coordination.standing import Standing
from robrain.deploy.processes.live_process import LiveStop, Place, live_endpoint, note, open_hub, open_when_there, tell
from robrain.deploy.processes.name_claim import LOOK_PERIOD_S, NameWatch, claim_coordinator
from robrain.deploy.processes.secured_start import check_certificate, check_rights
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.wire.access.member import MemberRole
from robrain.protocol.wire.hub import team_endpoints

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
    if identity is not None:
        check_rights("coordinator", note, session, where, identity)

    path = journal if journal is not None else Path(f"{team}.journal")

    def ready() -> None:
        should_stop.ready()
        tell(f"coordinator: of team {team}; Ctrl-C ends it")

    with closing(session):
        if standing.witnesses or standing.stands_by:
            should_stop.ready()
        if standing.witnesses:
            ElectedCoordinator(session, team, path, standing, policy, kept_rules, ready, _note).run(should_stop)
        else:
            _lead(session, team, path, policy, kept_rules, should_stop, ready, stands_by=standing.stands_by)


def _lead(
    session: zenoh.Session,
    team: str,
    path: Path,
    policy: PlanningPolicy,
    rules: Sequence[Rule],
    should_stop: Callable[[], bool],
    on_ready: Callable[[], None],
    *,
    stands_by: bool,
) -> None:
    """Lead once no other coordinator does, until `should_stop()`."""
    with claim_coordinator(session, team) as claim, live_endpoint(session, team) as wire:
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
            on_ready()

        try:
            kept.own()
            run_coordinator(wire, watch, ready, kept, policy, rules)
        finally:
            kept.close()
        watch.check()


def _note(text: str) -> None:
    note(f"coordinator: {text}")


def _open_journal(path: Path, should_stop: Callable[[], bool], *, stands_by: bool) -> Journal | None:
    """The journal; None if `should_stop` came first.

    A coordinator that hangs has lost its name and still has its journal, until it goes on or is ended. One that stands
    by waits for that: no two ever write the same tasks.

    Raises:
        JournalError: the journal cannot be used; JournalLocked only if it does not stand by.

    """
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
