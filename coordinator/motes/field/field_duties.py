"""Motes on duty in turn: as few as cover what all cover, the full ones first; the others rest."""

from robrain.coordinator.motes.field.field_ledger import FieldLedger
from robrain.coordinator.motes.field.field_policy import MoteFieldPolicy
from robrain.protocol.model.motes.coverage import duty_set
from robrain.protocol.tinyos.payloads import PERIOD_MAX_S
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.messages.motes.mote_messages import MoteDuty
from robrain.protocol.wire.topics import MOTE_DUTY

BY = "mote field"
AGAIN_NS = to_ns(60.0)
"""A mote that goes on otherwise is asked again after so long (chosen)."""
OF_AGE = 0.4
"""A resting mote speaks at least as often as this share of the age at which it would be collected (chosen)."""
PERIOD_STEP_S = 0.1
"""Motes tell their period in such steps."""


class FieldDuties:
    """Asks motes how often to sense, by turns.

    Args:
        wire: the coordinator's Zenoh endpoint.
        ledger: of the motes.

    """

    def __init__(self, wire: Endpoint, ledger: FieldLedger) -> None:
        self.on_duty: set[str] = set()
        """Names of the motes that are on duty."""
        self._wire = wire
        self._ledger = ledger
        self._asked: dict[str, tuple[float, int]] = {}
        """Period and time for which each mote was asked."""
        self._resting: set[str] = set()
        self._turn_ns = 0

    def step(self, policy: MoteFieldPolicy, now_ns: int) -> None:
        """Put motes on and off duty if it is time, and repeat what was not heeded."""
        living = [mote for mote in self._ledger.motes.values() if not mote.is_dead(now_ns)]
        if policy.turns_s and living and now_ns >= self._turn_ns:
            self._turn_ns = now_ns + to_ns(policy.turns_s)
            self._resting = self._choose(now_ns)
        self.on_duty = {mote.name for mote in living} - self._resting
        for mote in living if policy.turns_s else ():
            wanted_s = _resting_s(policy, mote.usual_period_s) if mote.name in self._resting else mote.usual_period_s
            period_s, asked_ns = self._asked.get(mote.name, (mote.usual_period_s, 0))
            is_unheeded = abs(mote.period_s - wanted_s) > PERIOD_STEP_S and now_ns >= asked_ns + AGAIN_NS
            if wanted_s != period_s or is_unheeded:
                self._ask(mote.name, wanted_s, now_ns)

    def _choose(self, now_ns: int) -> set[str]:
        """Names of the motes that may rest: the floor is covered without them."""
        placed = self._ledger.placed()
        left = {number: mote.left_share for number, mote in enumerate(placed) if not mote.is_dead(now_ns)}
        chosen = duty_set(self._ledger.cover(), left) if left else []
        return {placed[number].name for number in left if number not in chosen}

    def _ask(self, mote: str, period_s: float, now_ns: int) -> None:
        self._asked[mote] = (period_s, now_ns)
        publisher = self._wire.publisher(MOTE_DUTY, mote=mote)
        publisher.put(MoteDuty(mote=mote, period_s=period_s, by=BY))
        publisher.close()


def _resting_s(policy: MoteFieldPolicy, usual_s: float) -> float:
    """Period off duty; so short that no robot is sent to a mote only because it rests."""
    longest_s = policy.collect_age_s * OF_AGE if policy.collect_age_s else PERIOD_MAX_S
    return max(usual_s, min(PERIOD_MAX_S, longest_s, policy.rest_factor * usual_s))
