"""`robrain coordinator`: coordinate a team, alone, as the one that stands by, or elected by robots."""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import msgspec
import zenoh

from robrain.coordinator.journal.errors import JournalLocked, JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.live import run_coordinator
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.rules.rule import Rule
from robrain.coordinator.standing.candidate import Candidate, Elected, Lost
from robrain.coordinator.standing.stand_by import Following, StandBy
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import LiveStop, Place, live_endpoint, note, open_hub, open_when_there, tell
from robrain.deploy.processes.name_claim import LOOK_PERIOD_S, NameClaim, NameWatch, claim_coordinator
from robrain.deploy.processes.secured_start import check_certificate, check_rights
from robrain.protocol.access.member import MemberRole
from robrain.protocol.keys import check_name
from robrain.protocol.messages.robots.plugin_messages import ProcessInfo
from robrain.protocol.messages.robots.witness_messages import WITNESSES_MAX
from robrain.protocol.model.ranges import NAME_MAX, cut
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.table.topics import COORDINATOR_ALIVE
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.hub import team_endpoints

PERIOD_S = 0.01
LOOK_S = 1.0
"""How long is listened for a coordinator before there seems to be none."""

WORDS = {
    Following.COPYING: "copying the coordinator's journal",
    Following.BEHIND: "the copy of the journal may lack what was acknowledged last",
    Following.IN_STEP: "in step: nothing is acknowledged that is not in the copy of the journal",
}
GO_ON = "; if it will not return, end this process and start robrain coordinator --journal {path}"
GONE = {
    Following.ALONE: "it was in step when that was heard last",
    Following.BEHIND: "it may lack what was acknowledged last",
    Following.COPYING: "it is not whole, so no coordinator can go on from it",
}


def copy_journal(
    wire: Endpoint, path: Path, process: ProcessInfo, should_stop: Callable[[], bool], note: Callable[[str], None]
) -> bool:
    """Keep a copy of the journal of the coordinator there is, in a file of this process.

    Returns:
        Whether to stand by as one that shares the coordinator's journal does: the file is locked by that, or no
        coordinator is there and the file is no copy. False if `should_stop` came.

    Raises:
        JournalError: the file cannot be used.

    """
    try:
        journal = Journal(path, lock_timeout_s=0.0)
    except JournalLocked:
        return True
    with closing(journal):
        if not journal.copied and not wire.present(COORDINATOR_ALIVE):
            time.sleep(LOOK_S)
            if not wire.present(COORDINATOR_ALIVE):
                return True
        stand_by = StandBy(wire, journal, cut(f"{process.host}-{process.pid}", NAME_MAX))
        note(f"standing by with a copy of the journal in {path}")
        told: Following | None = None
        is_gone = False
        look_s = time.monotonic() + LOOK_S
        while not should_stop():
            stand_by.step()
            if time.monotonic() > look_s:
                look_s += LOOK_S
                if not journal.copied and not wire.present(COORDINATOR_ALIVE):
                    return True  # the file has never become a copy, and the coordinator has gone
            now = stand_by.following(now_ns := wire.clock.now_ns())
            if now is not told and now in WORDS:
                note(WORDS[now])
            was_gone, is_gone = is_gone, stand_by.is_silent(now_ns)
            if is_gone and not was_gone and now in GONE:
                end = "" if now is Following.COPYING else GO_ON.format(path=path)
                note(f"the coordinator is silent. The copy of its journal: {GONE[now]}{end}")
            told = now
            time.sleep(PERIOD_S)
    return False


class LeadershipOptions(NamedTuple):
    """How a coordinator comes to lead."""

    stands_by: bool = False
    """It waits for as long as another coordinator is there."""
    witnesses: tuple[str, ...] = ()
    """Names of the robots that elect one of several coordinators; none if there is no election."""
    is_forced: bool = False
    """An operator says that no other journal has more."""

    @classmethod
    def of(cls, witnesses: str | None, *, stands_by: bool, leads_anyway: bool) -> "LeadershipOptions":
        """From options such as `--witnesses r1,r2,r3` (UsageError if they have another form).

        With witnesses each coordinator stands by until it is elected, so `stands_by` adds nothing.
        """
        if witnesses is None:
            if leads_anyway:
                raise UsageError("--lead-anyway without --witnesses: expected both")
            return cls(stands_by)
        names = [check_name("robot", name) for name in witnesses.split(",")]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise UsageError(f"--witnesses {witnesses}: expected each robot once, got {twice[0]} more often")
        if len(names) > WITNESSES_MAX:
            raise UsageError(f"--witnesses: expected at most {WITNESSES_MAX} robots, got {len(names)}")
        return cls(witnesses=tuple(names), is_forced=leads_anyway)


WHY_PERIOD_S = 5.0
"""Minimum time from the start, and between two notes, before a note says why the process is not elected."""
AGAIN_S = 1.0
"""Pause after an election that was won in vain, because the journal cannot be written."""

ShouldStop = Callable[[], bool]


class ElectedCoordinator:
    """Leads a team for as long as more than half of its witnesses want that, and stands by otherwise.

    Args:
        session: the process's Zenoh session.
        team: the team's name.
        path: file of its own journal.
        standing: the witnesses, and whether an operator forces the first election.
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
        standing: LeadershipOptions,
        policy: PlanningPolicy,
        rules: Sequence[Rule],
        on_ready: Callable[[], None],
        note: Callable[[str], None],
    ) -> None:
        self._session, self._team, self._path = session, team, path
        self._witnesses, self._is_forced = standing.witnesses, standing.is_forced
        self._policy, self._rules = policy, rules
        self._on_ready, self._record = on_ready, note

    def run(self, should_stop: ShouldStop) -> None:
        """Stand by and lead by turns until `should_stop()` (JournalError if the file cannot be used)."""
        while not should_stop():
            with claim_coordinator(self._session, self._team) as claim:
                elected = self._await_election(claim, should_stop)
                if elected is None:
                    return
                self._is_forced = False
                self._record(f"elected, by election {elected.won.election}")
                try:
                    why_not = self._lead(elected, claim, should_stop)
                except JournalUnwritable as error:
                    why_not = str(error)
                    time.sleep(AGAIN_S)
            if why_not:
                self._record(f"{why_not}: this one stands by")

    def _lead(self, elected: Elected, claim: NameClaim, should_stop: ShouldStop) -> str:
        """Lead until `should_stop()`; returns why it leads no longer, in words, if there is another reason."""
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
        """Stand by until it is elected; None if `should_stop` came first."""
        with closing(Journal(self._path)) as journal, live_endpoint(self._session, self._team) as wire:
            candidate = Candidate(wire, self._witnesses, journal.name, is_forced=self._is_forced)
            stand_by = StandBy(wire, journal, cut(f"{claim.info.host}-{claim.info.pid}", NAME_MAX), candidate)
            notes = _Notes(self._record)
            while stand_by.elected is None and not should_stop():
                stand_by.step()
                notes.follow(stand_by, candidate, wire.clock.now_ns())
                time.sleep(PERIOD_S)
            return stand_by.elected


class _Notes:
    """Prints what has changed for a coordinator that stands by."""

    def __init__(self, note: Callable[[str], None]) -> None:
        self._record = note
        self._following: Following | None = None
        self._is_silent = False
        self._unlike = ""
        self._lost: Lost | None = None
        self._lost_due_s = time.monotonic() + WHY_PERIOD_S

    def follow(self, stand_by: StandBy, candidate: Candidate, now_ns: int) -> None:
        """Print what has changed since the last call."""
        following = stand_by.following(now_ns)
        if following is not self._following and following in WORDS:
            self._record(WORDS[following])
        self._following = following
        was_silent, self._is_silent = self._is_silent, stand_by.is_silent(now_ns)
        if self._is_silent and not was_silent and following is Following.COPYING:
            end = "FILE.before-N has the last whole one"
            self._record(f"the coordinator is silent. The copy of its journal: {GONE[following]}; {end}")
        if stand_by.unlike != self._unlike:
            self._unlike = stand_by.unlike
            self._record(f"it does not stand by: {self._unlike}" if self._unlike else "it stands by")
        lost = candidate.lost
        if lost is not None and lost != self._lost and time.monotonic() > self._lost_due_s:
            self._lost, self._lost_due_s = lost, time.monotonic() + WHY_PERIOD_S
            self._record(f"not elected: {lost.words}")


NO_ELECTION = LeadershipOptions()


def coordinator_command(
    place: Place,
    team: str,
    journal: Path | None,
    objective: Objective | None = None,
    planning: Path | None = None,
    rules: Path | None = None,
    standing: LeadershipOptions = NO_ELECTION,
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
            ElectedCoordinator(session, team, path, standing, policy, kept_rules, ready, _record).run(should_stop)
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
        if stands_by and not copy_journal(wire, path, claim.info, should_stop, _record):
            return
        if not claim.take(_record, should_stop, stands_by=stands_by):
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


def _record(text: str) -> None:
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
                _record(f"{error}; waiting until it does not any more")
            time.sleep(LOOK_PERIOD_S)
    return None
