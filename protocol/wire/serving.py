"""How a component is driven and asked: who moves time, where queries are answered, what a handler gets."""

from collections.abc import Callable
from enum import StrEnum
from typing import Generic, NamedTuple

from robrain.protocol.wire.access.member import Member
from robrain.protocol.wire.errors import CallError
from robrain.protocol.wire.topic import Q, R

OnOutside = Callable[[str, bytes], None]


class Drive(StrEnum):
    """Who moves time: the wall, or the lockstep runner."""

    LIVE = "live"
    LOCKSTEP = "lockstep"


class Serve(StrEnum):
    """Where queries are answered in the live drive."""

    AT_ONCE = "at_once"
    """On the thread that Zenoh gives the queryable; one after the other."""
    SHARED = "shared"
    """As POOL, on threads that the endpoint's queries of this kind share: for what is asked rarely."""
    POOL = "pool"
    """On threads of its own, several at a time; `busy` when there are too many."""
    IN_STEP = "in_step"
    """When the component calls `serve()`."""


class Request(NamedTuple, Generic[Q]):
    """A query as its handler sees it."""

    names: dict[str, str]
    """Names in the key, and its team under `team`."""
    asked: Q
    """The request, decoded; bytes where the query has free JSON, None where nothing is said."""
    by: str = ""
    """Who asks, if the asker says: the parameter `by` of the selector, as in `robrain/t/robot/r1/call/p/f?by=ann`.
    In a secured team the member whom the router's rules vouch for, such as `operator:ann`."""
    trace: str = ""
    """Trace of the task that it is about, if the asker says: Zenoh's attachment."""
    asker: Member | None = None
    """That member; None where the team is not secured, and `by` is a claim."""


class Deferred(NamedTuple, Generic[R]):
    """A reply that is sent later, so that nothing else waits for what it depends on."""

    reply: R
    when: Callable[[Callable[[CallError | None], None]], None]
    """Takes a function that must be called once, on any thread: with None when the reply may be sent, or with the
    error to send instead."""


Handler = Callable[[Request[Q]], R | bytes | Deferred[R]]
"""Returns the reply (bytes go as they are), or raises CallError."""
