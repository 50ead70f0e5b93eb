"""A reply that is not waited for: whoever asked looks now and then whether it has come."""

from typing import Any

import msgspec
import zenoh

from robrain.protocol.wire.errors import CallError, ErrorCode, ErrorReply, NobodyThere

ZENOH_TIMEOUT = b"Timeout"
"""What Zenoh itself replies with when nobody has replied in time."""


class Later:
    """The reply to one query; made by `Endpoint.ask_later`.

    Args:
        key: that was asked.
        replies: the query's channel; it says None as long as there is nothing, and raises ZError at its end.
        known: what is known already, in place of a channel.

    """

    def __init__(self, key: str, replies: Any = None, known: bytes | CallError | NobodyThere | None = None) -> None:
        self._key = key
        self._replies = replies
        self._known = known

    def take(self) -> bytes | None:
        """The reply; None as long as there is none. Not to be asked again once it is there.

        Raises:
            CallError: the reply is an error, or none came in time (`timeout`).
            NobodyThere: nobody answers that key.

        """
        if isinstance(self._known, Exception):
            raise self._known
        if self._known is not None:
            return self._known
        try:
            reply = self._replies.try_recv()
        except zenoh.ZError:
            raise NobodyThere(f"nobody answers {self._key}") from None
        if reply is None:
            return None
        if reply.ok is not None:
            return bytes(reply.ok.payload.to_bytes())
        raise call_error(reply.err)


def call_error(reply: zenoh.ReplyError | None) -> CallError:
    """What an error that came as a reply says."""
    payload = reply.payload.to_bytes() if reply is not None else b""
    if payload == ZENOH_TIMEOUT:
        return CallError(ErrorCode.TIMEOUT, "no reply in time")
    try:
        error = msgspec.json.decode(payload, type=ErrorReply)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return CallError(ErrorCode.FAILED, f"an error that is none of ours: {payload[:200].decode(errors='replace')}")
    return CallError(error.code, error.message, error.detail)
