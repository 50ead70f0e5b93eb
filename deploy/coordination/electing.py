"""A live coordinator of a team with witnesses: it stands by until robots elect it, leads, and stands by again.

The same command is started on each machine that may coordinate the team, each with its own journal.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import zenoh

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.live import run_coordinator
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.rules.rule import Rule
from robrain.coordinator.standing.candidate import Candidate, Elected, Lost
from robrain.coordinator.standing.stand_by import Following, StandBy
from robrain.deploy.coordination.following import GONE, PERIOD_S, WORDS
from robrain.deploy.coordination.standing import Standing
from robrain.deploy.processes.live_process import live_endpoint
from robrain.deploy.processes.name_claim import NameClaim, claim_coordinator
from robrain.protocol.model.ranges import NAME_MAX, cut

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
        standing: Standing,
        policy: PlanningPolicy,
        rules: Sequence[Rule],
        on_ready: Callable[[], None],
        note: Callable[[str], None],
    ) -> None:
        self._session, self._team, self._path = session, team, path
        self._witnesses, self._is_forced = standing.witnesses, standing.is_forced
        self._policy, self._rules = policy, rules
        self._on_ready, self._note = on_ready, note

    def run(self, should_stop: ShouldStop) -> None:
        """Stand by and lead by turns until `should_stop()` (JournalError if the file cannot be used)."""
        while not should_stop():
            with claim_coordinator(self._session, self._team) as claim:
                elected = self._await_election(claim, should_stop)
                if elected is None:
                    return
                self._is_forced = False
                self._note(f"elected, by election {elected.won.election}")
                try:
                    why_not = self._lead(elected, claim, should_stop)
                except JournalUnwritable as error:
                    why_not = str(error)
                    time.sleep(AGAIN_S)
            if why_not:
                self._note(f"{why_not}: this one stands by")

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
            notes = _Notes(self._note)
            while stand_by.elected is None and not should_stop():
                stand_by.step()
                notes.follow(stand_by, candidate, wire.clock.now_ns())
                time.sleep(PERIOD_S)
            return stand_by.elected


class _Notes:
    """Prints what has changed for a coordinator that stands by."""

    def __init__(self, note: Callable[[str], None]) -> None:
        self._note = note
        self._following: Following | None = None
        self._is_silent = False
        self._unlike = ""
        self._lost: Lost | None = None
        self._lost_due_s = time.monotonic() + WHY_PERIOD_S

    def follow(self, stand_by: StandBy, candidate: Candidate, now_ns: int) -> None:
        """Print what has changed since the last call."""
        following = stand_by.following(now_ns)
        if following is not self._following and following in WORDS:
            self._note(WORDS[following])
        self._following = following
        was_silent, self._is_silent = self._is_silent, stand_by.is_silent(now_ns)
        if self._is_silent and not was_silent and following is Following.COPYING:
            end = "FILE.before-N has the last whole one"
            self._note(f"the coordinator is silent. The copy of its journal: {GONE[following]}; {end}")
        if stand_by.unlike != self._unlike:
            self._unlike = stand_by.unlike
            self._note(f"it does not stand by: {self._unlike}" if self._unlike else "it stands by")
        lost = candidate.lost
        if lost is not None and lost != self._lost and time.monotonic() > self._lost_due_s:
            self._lost, self._lost_due_s = lost, time.monotonic() + WHY_PERIOD_S
            self._note(f"not elected: {lost.words}")
