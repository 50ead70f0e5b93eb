"""The nodes of one bus within a lockstep run: a frame goes to those whose filters take it, and to nobody else."""

from typing import ClassVar, Protocol
from weakref import WeakValueDictionary

from robrain.protocol.can.payload import IDENTIFIER

ROUTES_MAX = 4096
"""Identifiers whose receivers are remembered."""


class Node(Protocol):
    """One node on the bus."""

    def wants(self, traveling: bytes) -> bool:
        """Whether its filters take an identifier, as it travels."""

    def accept(self, payload: bytes) -> None:
        """Take a frame of another node, or its own."""


class Segment:
    """The nodes of one bus of one session."""

    _of_key: ClassVar["WeakValueDictionary[tuple[str, str], Segment]"] = WeakValueDictionary()

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._routes: dict[bytes, list[Node]] = {}

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

    def deliver(self, payload: bytes) -> None:
        """Hand a frame to the nodes that want it."""
        identifier = payload[IDENTIFIER]
        route = self._routes.get(identifier)
        if route is None:
            if len(self._routes) >= ROUTES_MAX:
                self._routes.clear()
            route = self._routes[identifier] = [node for node in self._nodes if node.wants(identifier)]
        for node in route:
            node.accept(payload)
