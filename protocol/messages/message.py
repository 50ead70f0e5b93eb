"""Base of all messages of the wire: frozen structs, JSON on the wire.

Unknown fields are ignored and new fields have defaults, so that older and newer peers talk. `stamp_ns` (the
run's clock) and `seq` are filled in by the publisher that sends the message.
"""

from collections.abc import Callable
from typing import Annotated, Any, Self, TypeVar

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Count, Quantity, Stamp

T = TypeVar("T")

Result = Annotated[dict[str, Any], Meta(max_length=64)]
COVARIANCE_LENGTHS = (0, 9)
Covariance = Annotated[tuple[Quantity, ...], Meta(max_length=9)]
JsonSchema = Annotated[dict[str, Any], Meta(max_length=1000)]
Prose = Annotated[str, Meta(max_length=100_000)]
"""Text by the author of a plugin."""


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """Fields of every published message."""

    stamp_ns: Stamp = 0
    seq: Count = 0


class SharedMessage(Message, frozen=True, dict=True):
    """A message that keeps values computed from it: components of one process that share it compute each once."""

    def derived(self, compute: Callable[[Self], T]) -> T:
        """Return `compute(self)`, computed by the first caller.

        `compute` is a named function of the message alone, and its result is read-only. A field whose conversion raises
        is not kept.
        """
        kept: dict[str, T] = self.__dict__
        name = f"{compute.__module__}.{compute.__qualname__}"
        if name not in kept:
            kept[name] = compute(self)
        return kept[name]
