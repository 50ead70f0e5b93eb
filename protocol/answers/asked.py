"""A query for the answering side, and its reply for the caller, by whatever link both travel."""

from typing import NamedTuple, Protocol

import msgspec
import zenoh

from robrain.protocol.errors import CallError
from robrain.protocol.topic import JSON

BY = "by"
"""Parameter of a selector: name of the caller, if it is stated."""


class Answer(NamedTuple):
    """One reply."""

    key: str
    """Key of the replying endpoint; empty if it is an error."""
    payload: bytes
    is_error: bool = False
    from_outside: bool = False
    """Whether it comes from another process."""


class Asked(Protocol):
    """One query. It ends when it is ended or no longer referred to."""

    @property
    def key(self) -> str:
        """Key expression that is asked."""

    @property
    def selector(self) -> str:
        """The key expression with its parameters."""

    @property
    def by(self) -> str:
        """Name of the caller; empty if it is not stated."""

    @property
    def payload(self) -> bytes:
        """The request; empty if there is none."""

    def reply(self, key: str, payload: bytes, encoding: str) -> None:
        """Send a reply.

        Raises:
            zenoh.ZError: its key is not one that is asked, or the session has closed.

        """

    def reply_error(self, error: CallError) -> None:
        """Send an error as a reply."""

    def end(self) -> None:
        """There are no more replies; calling it again does nothing."""


class ZenohQuery:
    """A query that came by Zenoh."""

    __slots__ = ("_query",)

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query

    @property
    def key(self) -> str:
        """See `Asked`."""
        return str(self._query.key_expr)

    @property
    def selector(self) -> str:
        """See `Asked`."""
        return str(self._query.selector)

    @property
    def by(self) -> str:
        """See `Asked`."""
        return self._query.parameters.get(BY) or ""

    @property
    def payload(self) -> bytes:
        """See `Asked`."""
        payload = self._query.payload
        return payload.to_bytes() if payload is not None else b""

    def reply(self, key: str, payload: bytes, encoding: str) -> None:
        """See `Asked`."""
        self._query.reply(key, payload, encoding=encoding)

    def reply_error(self, error: CallError) -> None:
        """See `Asked`."""
        self._query.reply_err(msgspec.json.encode(error.reply()), encoding=JSON)

    def end(self) -> None:
        """See `Asked`."""
        self._query.drop()


def answer_of(reply: zenoh.Reply, *, from_outside: bool = False) -> Answer:
    """A reply that came by Zenoh."""
    if reply.ok is not None:
        return Answer(str(reply.ok.key_expr), reply.ok.payload.to_bytes(), from_outside=from_outside)
    payload = reply.err.payload.to_bytes() if reply.err is not None else b""
    return Answer("", payload, is_error=True, from_outside=from_outside)
