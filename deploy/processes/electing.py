"""A live coordinator of a team with witnesses: it stands by until it is elected, leads, and stands by again.

The same command is started on each machine that may coordinate the team, each with a journal of its own.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import zenoh

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.live import run_coordinator
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.rules.rule import Rule
from robrain.coordinator.standing.candidate import Candidate, Elected
from robrain.coordinator.standing.stand_by import Following, StandBy
from robrain.deploy.processes.following import GONE, PERIOD_S, WORDS
from robrain.deploy.processes.live_process import live_endpoint
from robrain.deploy.processes.name_claim import NameClaim, claim_coordinator
from robrain.protocol.model.ranges import NAME_MAX, cut

WHY_PERIOD_S = 5.0
"""From the start, and between two notes why it is not elected, at least."""

AGAIN_S = 1.0
"""Pause after an election that came to nothing, as the journal cannot be written."""


class Candidacy(NamedTuple):
    """Who stands for election, and how."""

    team: str
    journal: Path
    """File of its own journal."""
    witnesses: Sequence[str]
    """Names of the robots that elect."""
    is_forced: bool = False
    """Whether an operator says, for the first election, that no other journal has more."""


def lead_when_elected(
    session: zenoh.Session,
    candidacy: Candidacy,
    policy: PlanningPolicy,
    rules: Sequence[Rule],
    should_stop: Callable[[], bool],
    on_ready: Callable[[], None],
    note: Callable[[str], None],
) -> None:
    """Stand by, lead, and stand by again, until `should_stop()`.

    Args:
        session: the process's Zenoh session.
        candidacy: who stands for election.
        policy: see Coordinator.
        rules: see Coordinator.
        should_stop: asked many times a second.
        on_ready: called each time that it leads.
        note: prints a line of progress.

    Raises:
        JournalError: the file cannot be used.

    """
    is_forced = candidacy.is_forced
    while not should_stop():
        with claim_coordinator(session, candidacy.team) as claim:
            elected = _await_election(session, candidacy, claim, should_stop, note, is_forced=is_forced)
            if elected is None:
                return
            is_forced = False
            note(f"elected, by election {elected.won.election}")
            try:
                superseded = _lead(session, candidacy, elected, claim, policy, rules, should_stop, on_ready)
            except JournalUnwritable as error:
                superseded = str(error)
                time.sleep(AGAIN_S)
        if superseded:
            note(f"{superseded}: this one stands by")


def _lead(
    session: zenoh.Session,
    candidacy: Candidacy,
    elected: Elected,
    claim: NameClaim,
    policy: PlanningPolicy,
    rules: Sequence[Rule],
    should_stop: Callable[[], bool],
    on_ready: Callable[[], None],
) -> str:
    """Lead until `should_stop()`, or until another one leads; returns that in words."""
    claim.take_over()
    with closing(Journal(candidacy.journal)) as journal, live_endpoint(session, candidacy.team) as wire:
        if journal.name != elected.journal:
            return "the journal was damaged, and may lack what was acknowledged"
        journal.own()

        def ready() -> None:
            claim.settle()
            on_ready()

        return run_coordinator(wire, should_stop, ready, journal, policy, rules, elected)


def _await_election(
    session: zenoh.Session,
    candidacy: Candidacy,
    claim: NameClaim,
    should_stop: Callable[[], bool],
    note: Callable[[str], None],
    *,
    is_forced: bool,
) -> Elected | None:
    with closing(Journal(candidacy.journal)) as journal, live_endpoint(session, candidacy.team) as wire:
        candidate = Candidate(wire, candidacy.witnesses, journal.name, is_forced=is_forced)
        stand_by = StandBy(wire, journal, cut(f"{claim.info.host}-{claim.info.pid}", NAME_MAX), candidate)
        told: Following | None = None
        is_gone, unlike = False, ""
        lost, why_s = candidate.lost, time.monotonic() + WHY_PERIOD_S
        while stand_by.elected is None and not should_stop():
            stand_by.step()
            now = stand_by.following(wire.clock.now_ns())
            if now is not told and now in WORDS:
                note(WORDS[now])
            told = now
            was, is_gone = is_gone, stand_by.is_silent(wire.clock.now_ns())
            if is_gone and not was and now is Following.COPYING:
                end = "FILE.before-N has the last whole one"
                note(f"the coordinator is silent. The copy of its journal: {GONE[now]}; {end}")
            if stand_by.unlike != unlike:
                unlike = stand_by.unlike
                note(f"it does not stand by: {unlike}" if unlike else "it stands by")
            if candidate.lost is not None and candidate.lost != lost and time.monotonic() > why_s:
                lost, why_s = candidate.lost, time.monotonic() + WHY_PERIOD_S
                note(f"not elected: {lost.words}")
            time.sleep(PERIOD_S)
        return stand_by.elected
