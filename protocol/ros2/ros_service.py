"""Services as `rmw_zenoh` does them: a server is a queryable, a request is a query."""

import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Generic, TypeVar

import zenoh

from robrain.protocol.ros2.attachment import Attachment
from robrain.protocol.ros2.errors import BadAttachment, BadCdr, NoReply
from robrain.protocol.ros2.message_types import MessageType, ServiceType
from robrain.protocol.ros2.tokens import Entity

WAITING_MAX = 64
"""Requests that wait in one server."""
CALL_S = 5.0
"""Time limit for a response unless another is given."""

Q = TypeVar("Q")
R = TypeVar("R")


class RosRequest(Generic[Q, R]):
    """A request that waits for its response; see `Request`. Dropping it without a word ends the query as well."""

    def __init__(
        self,
        query: zenoh.Query,
        key: str,
        sender: Attachment,
        request: Q,
        response: MessageType[R],
        now_ns: Callable[[], int],
    ) -> None:
        self.request = request
        self.sender = sender
        """Client's gid, the number of its request, and when it was sent."""
        self._query = query
        self._key = key
        self._response = response
        self._now_ns = now_ns

    def reply(self, response: R) -> None:
        """See `Request`.

        Raises:
            BadCdr: it cannot be encoded; the query is still open.

        """
        payload = self._response.encode(response)
        attachment = Attachment(self.sender.number, self._now_ns(), self.sender.gid)
        with suppress(zenoh.ZError), self._query:  # the client or the session may be gone
            self._query.reply(self._key, payload, attachment=attachment.pack())

    def refuse(self, why: str) -> None:
        """See `Request`."""
        _refuse(self._query, why)


class RosServer(Generic[Q, R]):
    """A service over a Zenoh session, which only appends on Zenoh's threads; `requests` decodes.

    Args:
        session: brings the requests.
        entity: the server as others see it.
        kind: type of the service.
        now_ns: the clock for stamps.

    """

    def __init__(
        self, session: zenoh.Session, entity: Entity, kind: ServiceType[Q, R], now_ns: Callable[[], int]
    ) -> None:
        self.entity = entity
        self.dropped = 0
        self.refused = 0
        self.on_arrival: Callable[[], None] | None = None
        """Called on Zenoh's thread after each request."""
        self._kind = kind
        self._now_ns = now_ns
        self._key = entity.key
        self._waiting: deque[zenoh.Query] = deque()
        self._lock = threading.Lock()
        callback: Any = zenoh.handlers.Callback(self._take, indirect=False)
        self._queryable: Any = session.declare_queryable(self._key, callback, complete=True)
        self._token: Any = session.liveliness().declare_token(entity.token)

    def requests(self) -> list[RosRequest[Q, R]]:
        """See `Server`."""
        with self._lock:
            waiting, self._waiting = self._waiting, deque()
        found = []
        for query in waiting:
            try:
                sender = Attachment.unpack(query.attachment.to_bytes() if query.attachment is not None else b"")
                request = self._kind.request.decode(query.payload.to_bytes() if query.payload is not None else b"")
            except (BadAttachment, BadCdr) as error:
                self.refused += 1
                _refuse(query, str(error))
                continue
            found.append(RosRequest(query, self._key, sender, request, self._kind.response, self._now_ns))
        return found

    def close(self) -> None:
        """See `Server`."""
        declared, self._queryable = self._queryable, None
        if declared is None:
            return
        with suppress(zenoh.ZError):  # the session is closed, which ended both
            self._token.undeclare()
            declared.undeclare()
        with self._lock:
            waiting, self._waiting = self._waiting, deque()
        for query in waiting:
            _refuse(query, "the service ends")

    def _take(self, query: zenoh.Query) -> None:
        size = len(query.payload) if query.payload is not None else 0
        if size > self._kind.request.max_bytes:
            self.refused += 1
            _refuse(query, f"{size} bytes: expected at most {self._kind.request.max_bytes}")
            return
        with self._lock:
            is_full = len(self._waiting) >= WAITING_MAX
            if not is_full:
                self._waiting.append(query)
        if is_full:
            self.dropped += 1
            _refuse(query, f"{WAITING_MAX} requests wait already")
        elif self.on_arrival is not None:
            self.on_arrival()


class RosCall(Generic[R]):
    """A request in progress."""

    def __init__(self, replies: Any, service: str, sender: Attachment, response: MessageType[R]) -> None:
        self._replies = replies
        self._service = service
        self._sender = sender
        self._response = response

    def poll(self) -> R | None:
        """The response, or None until it arrives.

        Raises:
            NoReply: there will be none.

        """
        try:
            while (reply := self._replies.try_recv()) is not None:
                response = self._read(reply)
                if response is not None:
                    return response
        except zenoh.ZError as error:
            raise NoReply(self._service, "no server, or no response in time") from error
        return None

    def wait(self) -> R:
        """The response; blocks until it is there or the time is over. Not for threads that step something.

        Raises:
            NoReply: there is none.

        """
        for reply in self._replies:
            response = self._read(reply)
            if response is not None:
                return response
        raise NoReply(self._service, "no server, or no response in time")

    def _read(self, reply: zenoh.Reply) -> R | None:
        """The response in a reply; None if it is one to another request."""
        if reply.ok is None:
            words = reply.err.payload.to_bytes()[:200].decode(errors="replace") if reply.err is not None else ""
            raise NoReply(self._service, f"refused: {words}")
        try:
            attached = reply.ok.attachment
            sender = Attachment.unpack(attached.to_bytes() if attached is not None else b"")
            if (sender.number, sender.gid) != (self._sender.number, self._sender.gid):
                return None
            return self._response.decode(reply.ok.payload.to_bytes())
        except (BadAttachment, BadCdr) as error:
            raise NoReply(self._service, str(error)) from error


class RosClient(Generic[Q, R]):
    """A client of a service, over a Zenoh session. Thread-safe. Arguments as for `RosServer`."""

    def __init__(
        self, session: zenoh.Session, entity: Entity, kind: ServiceType[Q, R], now_ns: Callable[[], int]
    ) -> None:
        self.entity = entity
        self.count = 0
        """Requests sent."""
        self._session = session
        self._kind = kind
        self._now_ns = now_ns
        self._gid = entity.gid
        self._lock = threading.Lock()
        self._token: Any = session.liveliness().declare_token(entity.token)

    def ask(self, request: Q, timeout_s: float = CALL_S) -> RosCall[R]:
        """Send a request.

        Raises:
            BadCdr: it cannot be encoded.

        """
        payload = self._kind.request.encode(request)
        with self._lock:
            self.count += 1
            sender = Attachment(self.count, self._now_ns(), self._gid)
        replies = self._session.get(
            self.entity.key,
            payload=payload,
            attachment=sender.pack(),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
        )
        return RosCall(replies, self.entity.name, sender, self._kind.response)

    def close(self) -> None:
        """Leave; requests in progress continue."""
        with suppress(zenoh.ZError):  # the session is closed, or this client
            self._token.undeclare()


def _refuse(query: zenoh.Query, why: str) -> None:
    with suppress(zenoh.ZError), query:  # the client or the session may be gone
        query.reply_err(why.encode())
