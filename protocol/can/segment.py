"""The nodes of one bus within a lockstep run: a frame goes to those whose filters take it, and to nobody else."""

from collections import deque
from collections.abc import Callable
from threading import get_ident
from typing import ClassVar, Protocol
from weakref import WeakValueDictionary

from robrain.protocol.can.payload import CLASSIC_BYTES, IDENTIFIER, NO_STAMP, STAMP

ROUTES_MAX = 4096
"""Identifiers and senders whose receivers are remembered."""


class Node(Protocol):
    """One node on the bus."""

    dropped: int
    """Frames lost because they were not received in time."""
    frames: deque[bytes]
    """Frames that have arrived; as many as its maxlen at the most."""
    on_frame: Callable[[], None] | None
    """Called after each."""

    def wants(self, traveling: bytes, sender: "Node") -> bool:
        """Whether it takes a sender's frames with an identifier, as it travels."""

    def accept(self, payload: bytes) -> None:
        """Take a frame that it wants."""


class Segment:
    """The nodes of one bus of one session."""

    _of_key: ClassVar["WeakValueDictionary[tuple[str, str], Segment]"] = WeakValueDictionary()

    def __init__(self) -> None:
        self._owner = get_ident()
        self._nodes: list[Node] = []
        self._routes: dict[tuple[bytes, int], list[Node]] = {}

    @classmethod
    def of(cls, session: str, key: str) -> "Segment":
        """The one segment of a key and a session, by its id; it goes with its last node."""
        found = cls._of_key.get((session, key))
        if found is None:
            found = cls._of_key[session, key] = cls()
        return found

    def join(self, node: Node) -> None:
        """Have a node receive from now on."""
        self._nodes.append(node)
        self._routes.clear()

    def leave(self, node: Node) -> None:
        """Have it receive no more."""
        if node in self._nodes:
            self._nodes.remove(node)
        self._routes.clear()

    def forget_filters(self) -> None:
        """A node's filters have changed."""
        self._routes.clear()

    def deliver(self, payload: bytes, sender: Node) -> None:
        """Hand a node's frame to the nodes that want it."""
        identifier = payload[IDENTIFIER]
        route = self._routes.get((identifier, id(sender)))
        if route is None:
            route = self._route(identifier, sender)
        if len(payload) > CLASSIC_BYTES or payload[STAMP] == NO_STAMP or get_ident() != self._owner:
            for node in route:
                node.accept(payload)
            return
        for node in route:  # as `accept` does with nearly all
            node.dropped += len(node.frames) == node.frames.maxlen
            node.frames.append(payload)
            if node.on_frame is not None:
                node.on_frame()

    def _route(self, identifier: bytes, sender: Node) -> list[Node]:
        if len(self._routes) >= ROUTES_MAX:
            self._routes.clear()
        route = [node for node in self._nodes if node.wants(identifier, sender)]
        self._routes[identifier, id(sender)] = route
        return route
