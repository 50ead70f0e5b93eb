"""Nodes, topics and services in a domain, by their tokens."""

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import zenoh

from robrain.protocol.ros2.errors import BadToken
from robrain.protocol.ros2.tokens import Entity, EntityKind, domain_tokens

ENTITIES_MAX = 16_384
"""Followed in one domain (chosen: a few hundred nodes, with the two dozen endpoints of each)."""

TOPIC_KINDS = (EntityKind.PUBLISHER, EntityKind.SUBSCRIPTION)


class RosGraph:
    """Follows the tokens of one domain. Thread-safe.

    Args:
        session: brings the tokens.
        domain: the domain's id.
        on_change: called on Zenoh's thread after each change.

    """

    def __init__(self, session: zenoh.Session, domain: int = 0, on_change: Callable[[], None] | None = None) -> None:
        self.refused = 0
        """Tokens that cannot be read."""
        self.dropped = 0
        """Tokens skipped because there are too many."""
        self._on_change = on_change
        self._entities: dict[str, Entity] = {}
        self._lock = threading.Lock()
        callback: Any = zenoh.handlers.Callback(self._follow, indirect=False)
        self._subscriber: Any = session.liveliness().declare_subscriber(domain_tokens(domain), callback, history=True)

    def entities(self, *kinds: EntityKind) -> list[Entity]:
        """All that are there, or those of some kinds, ordered by token."""
        with self._lock:
            found = sorted(self._entities.items())
        return [entity for _, entity in found if not kinds or entity.kind in kinds]

    def nodes(self) -> list[str]:
        """Full names of the nodes, sorted; a name that two nodes share is there twice."""
        return sorted(entity.node.full_name for entity in self.entities(EntityKind.NODE))

    def topics(self) -> dict[str, list[str]]:
        """Types by topic, both sorted, as `ros2 topic list --show-types`."""
        return self._types(*TOPIC_KINDS)

    def services(self) -> dict[str, list[str]]:
        """Types by service that has a server, both sorted."""
        return self._types(EntityKind.SERVER)

    def endpoints(self, name: str, *kinds: EntityKind) -> list[Entity]:
        """Those of a topic or service, ordered by token."""
        return [entity for entity in self.entities(*kinds) if entity.name == name]

    def unheard(self, mine: Entity) -> list[Entity]:
        """Endpoints of the other side of its topic or service with another type or hash: they never meet `mine`."""
        others = {
            EntityKind.PUBLISHER: EntityKind.SUBSCRIPTION,
            EntityKind.SUBSCRIPTION: EntityKind.PUBLISHER,
            EntityKind.SERVER: EntityKind.CLIENT,
            EntityKind.CLIENT: EntityKind.SERVER,
        }
        kind = (mine.type_name, mine.type_hash)
        found = self.endpoints(mine.name, others[mine.kind])
        return [each for each in found if (each.type_name, each.type_hash) != kind]

    def close(self) -> None:
        """Follow no more."""
        with suppress(zenoh.ZError):  # the session is closed
            self._subscriber.undeclare()

    def _types(self, *kinds: EntityKind) -> dict[str, list[str]]:
        found: dict[str, set[str]] = {}
        for entity in self.entities(*kinds):
            found.setdefault(entity.name, set()).add(entity.type_name)
        return {name: sorted(found[name]) for name in sorted(found)}

    def _follow(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        try:
            entity = Entity.parse(token)
        except BadToken:
            with self._lock:
                self.refused += sample.kind == zenoh.SampleKind.PUT
            return
        with self._lock:
            if sample.kind != zenoh.SampleKind.PUT:
                self._entities.pop(token, None)
            elif token in self._entities or len(self._entities) < ENTITIES_MAX:
                self._entities[token] = entity
            else:
                self.dropped += 1
        if self._on_change is not None:
            self._on_change()
