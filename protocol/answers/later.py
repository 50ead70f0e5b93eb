"""A reply that arrives later: the caller polls it."""

from typing import Any, Generic

import msgspec
import zenoh

from robrain.protocol.answers.asked import Answer, answer_of
from robrain.protocol.border.border import other_names
from robrain.protocol.codec import BAD_PAYLOAD, BadPayload
from robrain.protocol.errors import CallError, ErrorCode, ErrorReply, NobodyThere
from robrain.protocol.topic import Query, R

ZENOH_TIMEOUT = b"Timeout"
"""Zenoh's own reply when no participant has replied in time."""


class Later(Generic[R]):
    """The reply to one query; made by `Endpoint.ask_later`.

    Args:
        key: that was asked, without a signature.
        topic: the query.
        replies: the query's channel; it returns None while there is no reply, and raises ZError at its end.
        known: known result, in place of a channel: the reply in a list, or the error.

    """

    def __init__(
        self,
        key: str,
        topic: Query[Any, R],
        replies: Any = None,
        known: list[R] | CallError | NobodyThere | None = None,
    ) -> None:
        self._key = key
        self._topic = topic
        self._replies = replies
        self._known = known

    def poll(self) -> R | None:
        """The reply; None until it arrives. Not to be asked again once it is there.

        Raises:
            CallError: the reply is an error, does not decode (`failed`), or none came in time (`timeout`).
            NobodyThere: no participant answers that key.

        """
        if isinstance(self._known, Exception):
            raise self._known
        if self._known is not None:
            return self._known[0]
        try:
            reply = self._replies.try_recv()
        except zenoh.ZError:
            raise NobodyThere(f"nobody answers {self._key}") from None
        if reply is None:
            return None
        return read_answer(self._topic, self._key, answer_of(reply))


def read_answer(topic: Query[Any, R], key: str, answer: Answer) -> R:
    """Decode the reply to a query.

    Raises:
        CallError: it is an error; or it is too large, does not decode, is out of range, or names another than was
            asked (`failed`).

    """
    if answer.is_error:
        raise call_error(answer.payload)
    try:
        reply = topic.payloads.read(answer.payload)
    except BadPayload as error:
        raise CallError(ErrorCode.FAILED, f"a bad reply: {error}") from error
    if topic.named_twice and (why := other_names(topic, topic.parse(key) or {}, reply)):
        raise CallError(ErrorCode.FAILED, f"a bad reply: {why}")
    return reply


def call_error(payload: bytes) -> CallError:
    """Text of an error that came as a reply."""
    if payload == ZENOH_TIMEOUT:
        return CallError(ErrorCode.TIMEOUT, "no reply in time")
    try:
        error = msgspec.json.decode(payload, type=ErrorReply)
    except BAD_PAYLOAD:
        return CallError(ErrorCode.FAILED, f"an error that is none of ours: {payload[:200].decode(errors='replace')}")
    return CallError(error.code, error.message, error.detail)
