"""A robot as a witness: it elects one of several coordinators, and stores which journals are complete.

Its answer is stored first, as it must survive a restart. A robot that is no witness is never asked, and still follows
the coordinator that was elected last.
"""

import logging
from typing import Protocol

import msgspec

from robrain.agent.host.host_extension import ExtendedHost, HostExtension
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.robots.witness_messages import (
    ROBOT_WITNESS,
    Holders,
    Led,
    WitnessRefusal,
    WitnessReply,
    WitnessRequest,
    WitnessWish,
)
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.ranges import Count, Name, Stamp
from robrain.protocol.wire.endpoint import Request, Serve

logger = logging.getLogger(__name__)

SILENT_NS = to_ns(2.0)
"""Time for which a witness votes for no other coordinator than the one that it received or elected last. A coordinator
without contact suspends itself sooner: `LEASE_NS` in `coordinator/leadership/mandate.py`."""


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of a witness's store."""

    election: Count = 0
    """Greatest number of an election in which it has voted, or of a coordinator whose request it has stored."""
    journal: Name = ""
    """The journal of the coordinator of that election."""
    began_ns: Stamp = 0
    """When that coordinator began to ask."""
    before: Name = ""
    """The journal of the last coordinator with another one; empty if there was none."""
    number: Count = 0
    """Number of the last `hold` request in that election."""
    holders: Holders = []
    """Journals that hold every acknowledged change; empty before the first `hold` request."""


class WitnessMemory(Protocol):
    """Storage of a witness."""

    def read(self) -> Kept:
        """Contents stored last (OSError, ValueError)."""

    def write(self, kept: Kept) -> None:
        """Store it; it survives a power cut when this returns (OSError)."""


class WitnessInMemory:
    """Storage that ends with the process, for lockstep."""

    def __init__(self) -> None:
        self._kept = Kept()

    def read(self) -> Kept:
        """See WitnessMemory."""
        return self._kept

    def write(self, kept: Kept) -> None:
        """See WitnessMemory."""
        self._kept = kept


class Witness(HostExtension):
    """Answers coordinators that ask for votes, and decides whose summaries count.

    Args:
        memory: place where it stores its answers.
        now_ns: when the robot's host starts. It may have obeyed a coordinator just before.

    """

    def __init__(self, memory: WitnessMemory, now_ns: int) -> None:
        self._memory = memory
        self._received_ns = now_ns
        self._obeyed = ""
        """Journal of the coordinator that was received or elected last."""
        self._received = Led(election=0, stamp_ns=0)
        """The last summary of a coordinator that was elected and leads."""
        self.led: Led | None = None
        """The coordinator that the robot follows, and its last summary; None if none was ever elected.

        A coordinator that it has elected since, and has not received yet, has sent none (stamp 0).
        """
        self._is_readable = True
        try:
            self._kept = memory.read()
        except (OSError, ValueError) as error:
            logger.warning("what the robot has answered as a witness cannot be read, so it answers nothing: %s", error)
            self._kept, self._is_readable = Kept(), False
        self._update_led()

    def follows(self, summary: TeamState) -> bool:
        """Whether a summary is of a coordinator that leads, by this robot's knowledge."""
        lead = summary.lead
        if lead is msgspec.UNSET:
            return True  # of a team without witnesses
        return not lead.is_suspended and lead.election >= self._greatest

    def receive_summary(self, summary: TeamState, now_ns: int) -> bool:
        """Record a summary; returns whether it is of a coordinator that leads."""
        lead = summary.lead
        if lead is msgspec.UNSET:
            return True  # of a team without witnesses
        if not self.follows(summary):
            return False
        self._obeyed, self._received_ns = lead.journal, now_ns
        self._received = Led(election=lead.election, stamp_ns=summary.stamp_ns)
        self._update_led()
        return True

    def answer(self, asked: WitnessRequest, now_ns: int) -> WitnessReply:
        """Grant or refuse a coordinator's request."""
        refusal = self._refusal(asked, now_ns)
        if refusal is None:
            refusal = self._store(asked)
        if refusal is None and asked.wish is WitnessWish.ELECT:
            self._obeyed, self._received_ns = asked.journal, now_ns
        return WitnessReply(refusal=refusal, election=self._greatest, before=self._kept.before)

    def restart_silence(self, now_ns: int) -> None:
        """Start the time of silence again: the process was stopped."""
        self._received_ns = now_ns

    @property
    def _greatest(self) -> int:
        return max(self._received.election, self._kept.election)

    def _refusal(self, asked: WitnessRequest, now_ns: int) -> WitnessRefusal | None:
        kept = self._kept
        if not self._is_readable:
            return WitnessRefusal.UNWRITABLE
        if asked.election < self._greatest:
            return WitnessRefusal.OUTVOTED
        if asked.wish is WitnessWish.HOLD:  # asked by the one that has won the election
            is_late = asked.election == kept.election and asked.number < kept.number
            return WitnessRefusal.OUTVOTED if is_late else None
        if asked.election == kept.election:
            return None if (asked.journal, asked.began_ns) == (kept.journal, kept.began_ns) else WitnessRefusal.OUTVOTED
        if asked.election == self._received.election:
            return WitnessRefusal.OUTVOTED
        if now_ns - self._received_ns <= SILENT_NS and self._obeyed != asked.journal:
            return WitnessRefusal.LEADER_SEEN
        if asked.forced:
            return None
        lacks = asked.journal not in kept.holders if kept.holders else asked.is_copy
        return WitnessRefusal.LACKS_CHANGES if lacks else None

    def _store(self, asked: WitnessRequest) -> WitnessRefusal | None:
        kept = self._kept
        if asked.wish is WitnessWish.HOLD:
            holders, number = asked.holders, asked.number
        else:
            holders = [asked.journal] if asked.forced else kept.holders
            number = kept.number if asked.election == kept.election else 0
        before = kept.before if asked.journal == kept.journal else kept.journal
        wanted = Kept(
            election=asked.election,
            journal=asked.journal,
            began_ns=asked.began_ns,
            before=before,
            number=number,
            holders=holders,
        )
        if wanted == kept:
            return None
        try:
            self._memory.write(wanted)
        except OSError as error:
            logger.warning("what the robot answers as a witness cannot be stored: %s", error)
            return WitnessRefusal.UNWRITABLE
        self._kept = wanted
        self._update_led()
        return None

    def _update_led(self) -> None:
        newest = self._received
        if self._kept.election > newest.election:
            newest = Led(election=self._kept.election, stamp_ns=0)
        self.led = newest if newest.election else None


class WitnessExtension(Witness):
    """The witness of a robot: it answers coordinators that ask its host.

    Args:
        host: the robot's host.
        memory: stores the witness's answers; None forgets them when the process ends.

    """

    def __init__(self, host: ExtendedHost, memory: WitnessMemory | None = None) -> None:
        super().__init__(memory or WitnessInMemory(), host.clock.now_ns())
        self._host = host

    def start(self) -> None:
        """Answer coordinators that ask for votes."""
        self._host.wire.answer(ROBOT_WITNESS, self._answer, serve=Serve.IN_STEP, robot=self._host.name)

    def extend_state(self, state: RobotState) -> RobotState:
        """Report the coordinator that the robot follows."""
        return state if self.led is None else msgspec.structs.replace(state, led=self.led)

    def _answer(self, request: Request[WitnessRequest]) -> WitnessReply:
        return self.answer(request.asked, self._host.clock.now_ns())
