"""Tokens by which a rehearsed order is confirmed: short-lived, for exactly one order, used at most once."""

import hmac
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from robrain.deploy.assistant.policy import Ban

LIFE_S = 120.0
"""Chosen: long enough for a person to read or hear what would happen, too short for the team to be another."""
CAPACITY = 32
T = TypeVar("T")


class _Waiting(NamedTuple, Generic[T]):
    who: str
    order: bytes
    plan: T
    until_s: float


class Confirmations(Generic[T]):
    """Orders that were rehearsed and wait to be confirmed.

    Args:
        now_s: a clock that never goes back, seconds.
        new_token: makes a token that cannot be guessed.
        life_s: how long an order waits.
        capacity: most orders that wait; the oldest is dropped for a new one.

    """

    def __init__(
        self,
        now_s: Callable[[], float],
        new_token: Callable[[], str],
        *,
        life_s: float = LIFE_S,
        capacity: int = CAPACITY,
    ) -> None:
        self.dropped = 0
        """Orders that were dropped for newer ones."""
        self.life_s = life_s
        self._now_s = now_s
        self._new_token = new_token
        self._capacity = capacity
        self._waiting: OrderedDict[str, _Waiting[T]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._waiting)

    def keep(self, who: str, order: bytes, plan: T) -> str:
        """Keep an order until it is confirmed.

        Args:
            who: the client that gives it; another cannot confirm it.
            order: the tool and all of its arguments, written in one way only.
            plan: what is carried out once it is confirmed.

        Returns:
            The token.

        """
        now_s = self._now_s()
        for token in [token for token, one in self._waiting.items() if one.until_s <= now_s]:
            del self._waiting[token]
        while len(self._waiting) >= self._capacity:
            self._waiting.popitem(last=False)
            self.dropped += 1
        token = self._new_token()
        self._waiting[token] = _Waiting(who, order, plan, now_s + self.life_s)
        return token

    def take(self, token: str, who: str, order: bytes) -> T | Ban:
        """The plan of an order that is confirmed, or why it is not. The token is void afterwards in any case."""
        one = self._waiting.pop(token, None)
        if one is None:
            return Ban.NO_TOKEN
        if one.until_s <= self._now_s():
            return Ban.EXPIRED
        if one.who != who or not hmac.compare_digest(one.order, order):
            return Ban.ANOTHER_ORDER
        return one.plan
