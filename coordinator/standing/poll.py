"""One question to all witnesses, and the answers so far."""

from collections.abc import Sequence
from typing import NamedTuple

from robrain.protocol.answers.later import Later
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.robots.witness_messages import WitnessRefusal, WitnessReply, WitnessRequest
from robrain.protocol.table.standing_topics import ROBOT_WITNESS
from robrain.protocol.wire.endpoint import Endpoint

ASK_TIMEOUT_S = 0.5
ASK_AGAIN_NS = to_ns(0.3)
"""Period for asking those again that have not answered, or have heard a coordinator just before."""

PASSES = (WitnessRefusal.LEADER_HEARD, WitnessRefusal.UNWRITABLE)
"""Refusals that may not last."""


class _Asked(NamedTuple):
    since_ns: int
    reply: Later[WitnessReply]


class Poll:
    """Asks all witnesses, and those without a final answer again and again.

    Args:
        wire: the coordinator's Zenoh endpoint.
        witnesses: names of robots.
        request: the question.
        now_ns: the time.

    """

    def __init__(self, wire: Endpoint, witnesses: Sequence[str], request: WitnessRequest, now_ns: int) -> None:
        self.request = request
        self.began_ns = self._ask_ns = now_ns
        self.granted_ns: dict[str, int] = {}
        """When each that has done as asked was asked for it."""
        self.refusals: dict[str, WitnessRefusal] = {}
        """Who has refused, and why."""
        self._elections: dict[str, int] = {}
        self.befores: set[str] = set()
        """Journals of coordinators that they had elected before this one."""
        self._wire, self._witnesses = wire, witnesses
        self._waiting: dict[str, _Asked] = {}
        self._ask()

    @property
    def election(self) -> int:
        """More than half of the witnesses know of no election with a greater number; 0 if that is not known.

        The greatest number of all would be that of one that is wrong.
        """
        return sorted([*self._elections.values(), *[0] * len(self._witnesses)], reverse=True)[
            (len(self._witnesses) - 1) // 2
        ]

    @property
    def is_won(self) -> bool:
        """Whether more than half have done as asked."""
        return 2 * len(self.granted_ns) > len(self._witnesses)

    @property
    def is_lost(self) -> bool:
        """Whether half or more will not do it."""
        final = sum(why not in PASSES for why in self.refusals.values())
        return 2 * final >= len(self._witnesses)

    @property
    def is_unanimous(self) -> bool:
        """Whether all have done it."""
        return len(self.granted_ns) == len(self._witnesses)

    @property
    def won_ns(self) -> int:
        """More than half were asked at this time or later, and did it."""
        return sorted(self.granted_ns.values(), reverse=True)[len(self._witnesses) // 2]

    def step(self, now_ns: int) -> None:
        """Take in the answers."""
        for name, asked in list(self._waiting.items()):
            try:
                reply = asked.reply.take()
            except (CallError, NobodyThere):
                del self._waiting[name]
                continue
            if reply is not None:
                del self._waiting[name]
                self._take(name, asked.since_ns, reply)
        if not 0 <= now_ns - self._ask_ns < ASK_AGAIN_NS:
            self._ask_ns = now_ns
            self._ask()

    def _take(self, name: str, asked_ns: int, reply: WitnessReply) -> None:
        self._elections[name] = reply.election
        if reply.refusal is not None:
            self.refusals[name] = reply.refusal
            return
        self.refusals.pop(name, None)
        self.granted_ns[name] = asked_ns
        self.befores.add(reply.before)

    def _ask(self) -> None:
        for name in self._witnesses:
            is_open = self.refusals.get(name) in (None, *PASSES)
            if is_open and name not in self.granted_ns and name not in self._waiting:
                reply = self._wire.ask_later(ROBOT_WITNESS, self.request, timeout_s=ASK_TIMEOUT_S, robot=name)
                self._waiting[name] = _Asked(self._ask_ns, reply)
