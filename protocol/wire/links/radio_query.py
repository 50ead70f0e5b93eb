"""One query between parties that hear each other by radio."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial

from robrain.protocol.wire.answers.asked import Answer, Asked
from robrain.protocol.wire.answers.local_query import Gathering, LocalQuery
from robrain.protocol.wire.links.radio_network import RadioNetwork, is_direct

After = Callable[[int, Callable[[], object]], object]
"""Does something after so many nanoseconds."""
Waiting = list[Callable[[], None]]
"""Requests that wait for a party whose process stands still."""


class RadioQuery:
    """A query on its way to those who answer it, and back.

    Args:
        network: how long request and reply take.
        party: who asks.
        now_ns: when.
        limit_ns: time limit for request and reply together.
        take: gets the replies.
        after: delivers a reply that arrives later; None if the asker waits, so that `take` gets it at once.

    """

    def __init__(
        self,
        network: RadioNetwork,
        party: str,
        now_ns: int,
        limit_ns: int,
        take: Callable[[Answer], None],
        after: After | None,
    ) -> None:
        self.is_late = False
        """Whether a request or a reply has not arrived within the limit."""
        self._network = network
        self._party = party
        self._now_ns = now_ns
        self._limit_ns = limit_ns
        self._take = take
        self._after = after

    def ask(
        self,
        selector: str,
        payload: bytes,
        answerers: Iterable[tuple[str, list[Callable[[Asked], None]]]],
        over: Callable[[], None],
        asleep: Mapping[str, Waiting],
    ) -> None:
        """Send the request.

        Args:
            selector: key expression, and parameters behind a `?`.
            payload: the request.
            answerers: parties that answer it, and with what.
            over: called after the last reply.
            asleep: parties whose process stands still; they take the request when it goes on, and reply too late.

        """
        asked = []
        for speaker, answers in answerers:
            self._network.counters.asked += not is_direct(self._party, speaker)
            there_ns = self._carried(self._party, speaker, len(selector) + len(payload), 0)
            if there_ns is None:
                continue
            if speaker in asleep:
                self._is_not_answered()
                asleep[speaker].extend(partial(_take_late, answer, selector, payload) for answer in answers)
            else:
                asked += [(speaker, there_ns, answer) for answer in answers]
        left = len(asked)
        if not left:
            over()

        def one_over() -> None:
            nonlocal left
            left -= 1
            if not left:
                over()

        for speaker, there_ns, answer in asked:
            back = partial(self.reply, speaker, there_ns)
            answer(LocalQuery(Gathering(selector, payload, 1, back, one_over)))

    def reply(self, speaker: str, there_ns: int, answer: Answer) -> None:
        """A party replies to a request that took so long to reach it."""
        took_ns = self._carried(speaker, self._party, len(answer.key) + len(answer.payload), there_ns)
        if took_ns is None:
            return
        if self._after is None or took_ns == 0:
            self._take(answer)
        else:
            self._after(took_ns, partial(self._take, answer))

    def _carried(self, speaker: str, hearer: str, size: int, before_ns: int) -> int | None:
        """How long a request or reply takes, and what came before it; None if it comes too late."""
        if is_direct(speaker, hearer):
            return 0
        took_ns = self._network.carry(speaker, hearer, size, self._now_ns, self._limit_ns - before_ns)
        if took_ns is None:
            self._is_not_answered()
            return None
        return before_ns + took_ns

    def _is_not_answered(self) -> None:
        self.is_late = True
        self._network.counters.timed_out += 1


def _take_late(answer: Callable[[Asked], None], selector: str, payload: bytes) -> None:
    """Hand over a request of which the asker has given up."""
    answer(LocalQuery(Gathering(selector, payload, 1, _drop, _ignore)))


def _drop(_answer: Answer) -> None:
    """The asker does not wait for it any more."""


def _ignore() -> None:
    """The asker does not wait for the end."""
