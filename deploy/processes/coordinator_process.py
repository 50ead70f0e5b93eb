"""`robrain coordinator`: coordinate a team, alone or elected by robots."""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import msgspec
import zenoh

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.leadership.candidate import Candidate, Following
from robrain.coordinator.leadership.election import Elected, Election, Lost
from robrain.coordinator.live import run_coordinator
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.rules.rule import Rule
from robrain.deploy.command_line.output import print_note, print_result
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import (
    LiveStop,
    Place,
    check_certificate,
    check_rights,
    live_endpoint,
    open_hub,
    open_when_there,
    steps,
)
from robrain.deploy.processes.name_claim import NameClaim, NameWatch, claim_coordinator
from robrain.protocol.access.member import MemberRole
from robrain.protocol.keys import check_name
from robrain.protocol.messages.robots.witness_messages import WITNESSES_MAX
from robrain.protocol.model.ranges import NAME_MAX, cut
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.wire.hub import team_endpoints

PERIOD_S = 0.01
WORDS = {
    Following.COPYING: "copying the coordinator's journal",
    Following.BEHIND: "the copy of the journal may lack what was acknowledged last",
    Following.IN_STEP: "in step: nothing is acknowledged that is not in the copy of the journal",
}


def read_witnesses(text: str | None, *, stands_by: bool = False) -> tuple[str, ...]:
    """Names of the robots that elect, from `r1,r2,r3`; none for a coordinator that is alone.

    Args:
        text: of the option.
        stands_by: whether the coordinator must be a candidate.

    Raises:
        UsageError: the text has another form, or a candidate has no witnesses.

    """
    if text is None:
        if stands_by:
            raise UsageError("--stand-by: expected the robots that elect as well, such as --witnesses r1,r2,r3")
        return ()
    names = [check_name("robot", name) for name in text.split(",")]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UsageError(f"--witnesses {text}: expected each robot once, got {twice[0]} more often")
    if len(names) > WITNESSES_MAX:
        raise UsageError(f"--witnesses: expected at most {WITNESSES_MAX} robots, got {len(names)}")
    return tuple(names)


WHY_PERIOD_S = 5.0
"""Minimum time from the start, and between two notes, before a note gives the reason why the process is not elected."""
AGAIN_S = 1.0
"""Pause after an election that was won in vain, because the journal cannot be written."""

ShouldStop = Callable[[], bool]


class ElectedCoordinator:
    """Leads a team while more than half of its witnesses want that, and is a candidate otherwise.

    Args:
        session: the process's Zenoh session.
        team: the team's name.
        path: file of this coordinator's journal.
        witnesses: names of the robots that elect.
        policy: see `Coordinator`.
        rules: see `Coordinator`.
        on_ready: called each time that it begins to lead.
        note: prints a line of progress.

    """

    def __init__(
        self,
        session: zenoh.Session,
        team: str,
        path: Path,
        witnesses: Sequence[str],
        policy: PlanningPolicy,
        rules: Sequence[Rule],
        on_ready: Callable[[], None],
        note: Callable[[str], None],
    ) -> None:
        self._session, self._team, self._path = session, team, path
        self._witnesses = witnesses
        self._policy, self._rules = policy, rules
        self._on_ready, self._record = on_ready, note

    def run(self, should_stop: ShouldStop) -> None:
        """Be a candidate and lead by turns until `should_stop()` (JournalError if the file cannot be used)."""
        while not should_stop():
            with claim_coordinator(self._session, self._team) as claim:
                elected = self._await_election(claim, should_stop)
                if elected is None:
                    return
                self._record(f"elected, by election {elected.won.election}")
                try:
                    end_reason = self._lead(elected, claim, should_stop)
                except JournalUnwritable as error:
                    end_reason = str(error)
                    time.sleep(AGAIN_S)
            if end_reason:
                self._record(f"{end_reason}: this one stands by")

    def _lead(self, elected: Elected, claim: NameClaim, should_stop: ShouldStop) -> str:
        """Lead until `should_stop()`; returns the reason for an earlier end, in words."""
        claim.take_over()
        with closing(Journal(self._path)) as journal, live_endpoint(self._session, self._team) as wire:
            if journal.name != elected.journal:
                return "the journal was damaged, and may lack what was acknowledged"
            journal.own()

            def ready() -> None:
                claim.settle()
                self._on_ready()

            return run_coordinator(wire, should_stop, ready, journal, self._policy, self._rules, elected)

    def _await_election(self, claim: NameClaim, should_stop: ShouldStop) -> Elected | None:
        """Follow or stand for election until it is elected; None if `should_stop` came first."""
        with closing(Journal(self._path)) as journal, live_endpoint(self._session, self._team) as wire:
            election = Election(wire, self._witnesses, journal.name)
            candidate = Candidate(wire, journal, cut(f"{claim.info.host}-{claim.info.pid}", NAME_MAX), election)
            progress = _Progress(self._record)
            for _ in steps(lambda: candidate.elected is not None or should_stop(), PERIOD_S):
                candidate.step()
                progress.record(candidate)
            return candidate.elected


class _Progress:
    """Prints the changes for a candidate."""

    def __init__(self, note: Callable[[str], None]) -> None:
        self._record = note
        self._following: Following | None = None
        self._unlike = ""
        self._lost: Lost | None = None
        self._lost_due_s = time.monotonic() + WHY_PERIOD_S

    def record(self, candidate: Candidate) -> None:
        """Print the changes since the last call."""
        following, lost = candidate.following, candidate.election.lost
        if following is not self._following and following in WORDS:
            self._record(WORDS[following])
        self._following = following
        if candidate.unlike != self._unlike:
            self._unlike = candidate.unlike
            self._record(f"it does not stand by: {self._unlike}" if self._unlike else "it stands by")
        if lost is not None and lost != self._lost and time.monotonic() > self._lost_due_s:
            self._lost, self._lost_due_s = lost, time.monotonic() + WHY_PERIOD_S
            self._record(f"not elected: {lost.words}")


def coordinator_command(
    place: Place,
    team: str,
    journal: Path | None,
    objective: Objective | None = None,
    planning: Path | None = None,
    rules: Path | None = None,
    witnesses: Sequence[str] = (),
) -> None:
    """Coordinate a team until Ctrl-C; wait until the endpoint answers.

    Args:
        place: endpoints to connect or listen; without either, the coordinator connects to this machine's hub.
        team: its name.
        journal: file of its tasks; `TEAM.journal` if None.
        objective: planning objective, overriding the file's.
        planning: file with a `[planning]` table.
        rules: file with `[[rules]]`.
        witnesses: names of the robots that elect it; none if it is alone.

    Raises:
        RobrainError: in one sentence.

    """
    policy = PlanningPolicy()
    if planning is not None:
        from robrain.deploy.processes.table_files import read_planning  # most coordinators need none and start sooner

        policy = read_planning(planning)
    if objective is not None:
        policy = msgspec.structs.replace(policy, objective=objective)
    kept_rules: tuple[Rule, ...] = ()
    if rules is not None:
        from robrain.deploy.processes.table_files import read_rules

        kept_rules = read_rules(rules)
    should_stop = LiveStop()
    where = place.connect or team_endpoints()
    identity = check_certificate("coordinator", print_note, [] if place.listen else where, team, MemberRole.COORDINATOR)
    if place.listen:
        session: zenoh.Session | None = open_hub(place.listen[0])[0]
    else:
        session = open_when_there("coordinator", where, should_stop)
    if session is None:
        return
    if identity is not None:
        check_rights("coordinator", print_note, session, where, identity)

    path = journal if journal is not None else Path(f"{team}.journal")

    def ready() -> None:
        should_stop.ready()
        print_result(f"coordinator: of team {team}; Ctrl-C ends it")

    with closing(session):
        if witnesses:
            should_stop.ready()
            ElectedCoordinator(session, team, path, witnesses, policy, kept_rules, ready, _record).run(should_stop)
        else:
            _lead_alone(session, team, path, policy, kept_rules, should_stop, ready)


def _lead_alone(
    session: zenoh.Session,
    team: str,
    path: Path,
    policy: PlanningPolicy,
    rules: Sequence[Rule],
    should_stop: Callable[[], bool],
    on_ready: Callable[[], None],
) -> None:
    """Lead until `should_stop()` (NameTaken if another coordinator does)."""
    with claim_coordinator(session, team) as claim, live_endpoint(session, team) as wire:
        if not claim.take(_record, should_stop):
            return  # before the journal is opened: only one process at a time may write it
        watch = NameWatch(claim, should_stop)

        def ready() -> None:
            claim.settle()
            on_ready()

        with closing(Journal(path)) as journal:
            journal.own()
            run_coordinator(wire, watch, ready, journal, policy, rules)
        watch.check()


def _record(text: str) -> None:
    print_note(f"coordinator: {text}")
