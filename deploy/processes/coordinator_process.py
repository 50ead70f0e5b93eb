"""`robrain coordinator`: coordinate a team, alone or elected by robots."""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import zenoh

from robrain.coordinator.coordinator import Coordinator
from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.leadership.candidate import Candidate, Following
from robrain.coordinator.leadership.election import Elected, Election
from robrain.coordinator.live import run_coordinator
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.command_line.output import print_message, print_result
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import (
    LiveStop,
    Place,
    check_certificate,
    check_rights,
    live_endpoint,
    open_hub,
    open_when_there,
)
from robrain.deploy.processes.name_claim import NameClaim, NameWatcher, claim_coordinator
from robrain.protocol.access.member import MemberRole
from robrain.protocol.clock import steps
from robrain.protocol.keys import check_name
from robrain.protocol.messages.robots.witness_messages import WITNESSES_MAX
from robrain.protocol.model.ranges import NAME_MAX, cut
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.rules.rule import Rule
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.wire.hub import team_endpoints
from robrain.recording.errors import MapError, RecordingError

if TYPE_CHECKING:  # loads kernels
    from robrain.algorithms.slam.floor_map import FloorMap

PERIOD_S = 0.01
WORDS = {
    Following.COPYING: "copying the coordinator's journal",
    Following.BEHIND: "the copy of the journal may lack what was acknowledged last",
    Following.IN_STEP: "in step: nothing is acknowledged that is not in the copy of the journal",
}


def read_witnesses(text: str | None, *, is_candidate: bool = False) -> tuple[str, ...]:
    """Names of the robots that elect, from `r1,r2,r3`; none for a coordinator that is alone.

    Args:
        text: of the option.
        is_candidate: whether the coordinator must be a candidate.

    Raises:
        UsageError: the text has another form, or a candidate has no witnesses.

    """
    if text is None:
        if is_candidate:
            raise UsageError("--stand-by: expected the robots that elect as well, such as --witnesses r1,r2,r3")
        return ()
    names = [check_name("robot", name) for name in text.split(",")]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UsageError(f"--witnesses {text}: expected each robot once, got {twice[0]} more often")
    if len(names) > WITNESSES_MAX:
        raise UsageError(f"--witnesses: expected at most {WITNESSES_MAX} robots, got {len(names)}")
    return tuple(names)


REASON_PERIOD_S = 5.0
"""Minimum time from the start, and between two messages, before the reason is printed why it is not elected."""
AGAIN_S = 1.0
"""Pause after an election that was won in vain, because the journal cannot be written."""

ShouldStop = Callable[[], bool]


class LiveCoordination(NamedTuple):
    """Leads a team: alone, or while more than half of its witnesses want that."""

    session: zenoh.Session
    team: str
    path: Path
    """File of this coordinator's journal."""
    policy: PlanningPolicy
    rules: Sequence[Rule]
    missions: Sequence[Mission]
    floor: "FloorMap | None"
    """Known before the run; None if the team has to explore."""
    on_ready: Callable[[], None]
    """Called each time that it begins to lead."""

    def lead_alone(self, should_stop: ShouldStop) -> None:
        """Lead until `should_stop()` (NameInUse if another coordinator does)."""
        with claim_coordinator(self.session, self.team) as claim:
            if not claim.acquire(_print, should_stop):
                return  # before the journal is opened: only one process at a time may write it
            watch = NameWatcher(claim, should_stop)
            with closing(Journal(self.path)) as journal:
                self._lead(journal, claim, watch)
            watch.check()

    def lead_elected(self, witnesses: Sequence[str], should_stop: ShouldStop) -> None:
        """Be a candidate and lead by turns until `should_stop()` (JournalError if the file cannot be used)."""
        while not should_stop():
            with claim_coordinator(self.session, self.team) as claim:
                elected = self._await_election(witnesses, claim, should_stop)
                if elected is None:
                    return
                _print(f"elected, by election {elected.won.election}")
                try:
                    claim.take_over()
                    with closing(Journal(self.path)) as journal:
                        end_reason = "the journal was damaged, and may lack what was acknowledged"
                        if journal.name == elected.journal:
                            end_reason = self._lead(journal, claim, should_stop, elected)
                except JournalUnwritable as error:
                    end_reason = str(error)
                    time.sleep(AGAIN_S)
            if end_reason:
                _print(f"{end_reason}: this one stands by")

    def _lead(self, journal: Journal, claim: NameClaim, should_stop: ShouldStop, elected: Elected | None = None) -> str:
        """Lead until `should_stop()`; returns the reason for an earlier end, in words."""
        journal.own()

        def ready() -> None:
            claim.settle()
            self.on_ready()

        with live_endpoint(self.session, self.team) as wire:
            coordinator = Coordinator(wire, journal, self.policy, self.rules, elected, self.missions, self.floor)
            return run_coordinator(coordinator, should_stop, ready)

    def _await_election(self, witnesses: Sequence[str], claim: NameClaim, should_stop: ShouldStop) -> Elected | None:
        """Follow or stand for election until it is elected; None if `should_stop` came first."""
        with closing(Journal(self.path)) as journal, live_endpoint(self.session, self.team) as wire:
            election = Election(wire, witnesses, journal.name)
            candidate = Candidate(wire, journal, cut(f"{claim.info.host}-{claim.info.pid}", NAME_MAX), election)
            progress = _Progress()
            for _ in steps(lambda: candidate.elected is not None or should_stop(), PERIOD_S):
                candidate.step()
                progress.record(candidate)
            return candidate.elected


class _Progress:
    """Prints the changes for a candidate."""

    def __init__(self) -> None:
        self._following: Following | None = None
        self._unlike = ""
        self._lost = ""
        self._lost_due_s = time.monotonic() + REASON_PERIOD_S

    def record(self, candidate: Candidate) -> None:
        """Print the changes since the last call."""
        following, lost = candidate.following, candidate.election.lost
        if following is not self._following and following in WORDS:
            _print(WORDS[following])
        self._following = following
        if candidate.unlike != self._unlike:
            self._unlike = candidate.unlike
            _print(f"it does not stand by: {self._unlike}" if self._unlike else "it stands by")
        if lost is not None and time.monotonic() > self._lost_due_s and lost.words != self._lost:
            self._lost, self._lost_due_s = lost.words, time.monotonic() + REASON_PERIOD_S
            _print(f"not elected: {lost.words}")


def coordinator_command(
    place: Place,
    team: str,
    journal: Path | None,
    objective: Objective | None = None,
    planning: Path | None = None,
    rules: Path | None = None,
    witnesses: Sequence[str] = (),
    floor: Path | None = None,
) -> None:
    """Coordinate a team until Ctrl-C; wait until the endpoint answers.

    Args:
        place: endpoints to connect or listen; without either, the coordinator connects to this machine's hub.
        team: its name.
        journal: file of its tasks; `TEAM.journal` if None.
        objective: planning objective, overriding the file's.
        planning: file with a `[planning]` table.
        rules: file with `[[rules]]` and `[[missions]]`.
        witnesses: names of the robots that elect it; none if it is alone.
        floor: map_server file, or recording, of a known floor.

    Raises:
        RobrainError: in one sentence.

    """
    policy, kept_rules, missions = PlanningPolicy(), tuple[Rule, ...](), tuple[Mission, ...]()
    if planning is not None or rules is not None:
        from robrain.deploy.processes.table_files import read_planning, read_rules  # most need none and start sooner

        policy = policy if planning is None else read_planning(planning)
        if rules is not None:
            tables = read_rules(rules)
            kept_rules, missions = tables.rules, tables.missions
    if objective is not None:
        policy = msgspec.structs.replace(policy, objective=objective)
    known_floor = None if floor is None else _read_floor(floor)
    should_stop = LiveStop()
    where = place.connect or team_endpoints()
    identity = check_certificate(
        "coordinator", print_message, [] if place.listen else where, team, MemberRole.COORDINATOR
    )
    if place.listen:
        session: zenoh.Session | None = open_hub(place.listen[0])[0]
    else:
        session = open_when_there("coordinator", where, should_stop)
    if session is None:
        return
    if identity is not None:
        check_rights("coordinator", print_message, session, where, identity)

    def ready() -> None:
        should_stop.ready()
        print_result(f"coordinator: of team {team}; Ctrl-C ends it")

    with closing(session):
        path = journal if journal is not None else Path(f"{team}.journal")
        coordination = LiveCoordination(session, team, path, policy, kept_rules, missions, known_floor, ready)
        if witnesses:
            should_stop.ready()
            coordination.lead_elected(witnesses, should_stop)
        else:
            coordination.lead_alone(should_stop)


def _read_floor(path: Path) -> "FloorMap":
    from robrain.recording.reader.floor_file import read_floor  # most need none and start sooner

    try:
        return read_floor(path)
    except (MapError, RecordingError) as error:
        raise UsageError(f"--floor: {error}") from error


def _print(text: str) -> None:
    print_message(f"coordinator: {text}")
