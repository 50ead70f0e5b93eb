"""One row of the table of topics: a key of the wire, what travels under it, and how it is delivered."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, lru_cache
from operator import attrgetter
from typing import Annotated, Any, get_origin

import msgspec

from robrain.protocol.wire.keys import ROOT, check_name


class Kind(StrEnum):
    """What travels under a key."""

    PUT = "put"
    QUERY = "query"
    TOKEN = "token"


class Role(StrEnum):
    """Who publishes, or answers, a topic."""

    ROBOT = "robot"
    COORDINATOR = "coordinator"
    OPERATOR = "operator"
    ARENA = "arena"


class Delivery(StrEnum):
    """What happens to samples that cannot be delivered at once."""

    LATEST = "latest"
    """Only the last one of a key counts; dropped under congestion."""
    EVERY = "every"
    """Each counts, none is sent again; dropped under congestion."""
    LOSSLESS = "lossless"
    """Kept by the sender and sent again after a cut; late joiners get what is kept."""


class Urgency(StrEnum):
    """Zenoh priorities that are in use, most urgent first."""

    REAL_TIME = "real_time"
    INTERACTIVE_HIGH = "interactive_high"
    DATA = "data"
    DATA_LOW = "data_low"


JSON = "application/json"
CAN_FRAME = "application/vnd.robrain.can-frame"
TINYOS_PACKET = "application/vnd.robrain.tinyos-packet"
PNG = "image/png"
PARSED_KEYS = 4096
"""Keys of one topic whose parsed names are cached: there are few, and each arrives many times."""


@dataclass(frozen=True, kw_only=True)
class Topic:
    """One row of the table."""

    name: str
    pattern: str
    """Key below `robrain/{team}/`; `{name}` chunks are filled in."""
    doc: str
    by: Role
    kind: Kind = Kind.PUT
    message: Any = None
    """Type of the payload (of the request, for a query); None for bytes and for free JSON."""
    rate_hz: float | None = None
    delivery: Delivery = Delivery.EVERY
    urgency: Urgency = Urgency.DATA
    recorded: bool = False
    reads_only: bool = False
    """A query that changes nothing where it is answered."""
    encoding: str = JSON
    max_bytes: int | None = None
    """Largest payload that publisher and receivers accept; None for no limit."""
    is_blocking: bool = False
    """Puts wait while the network is congested, instead of being dropped, and are sent at once, not in batches."""
    cache: int = 64
    """Samples that the sender of a lossless topic keeps."""

    @cached_property
    def chunks(self) -> tuple[str, ...]:
        """The pattern, split."""
        return tuple(self.pattern.split("/"))

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Names that the key is built from, in order."""
        return tuple(chunk[1:-1] for chunk in self.chunks if chunk.startswith("{"))

    @cached_property
    def named_twice(self) -> tuple[tuple[str, Callable[[Any], str]], ...]:
        """Names that are in both key and payload, each with a function that reads it from a message."""
        said = getattr(self.message, "__struct_fields__", ()) if self.kind is Kind.PUT else ()
        return tuple((field, _reader(self.message, field)) for field in self.fields if field in said)

    def too_large(self, size: int) -> str:
        """The error text for a payload of `size` bytes."""
        return f"expected at most {self.max_bytes} bytes of {self.name}, got {size}"

    def key(self, team: str, /, **names: str) -> str:
        """The concrete key.

        Raises:
            BadName: a name cannot be part of a key.
            KeyError: a name is missing, or one too many.
        """
        if set(names) != set(self.fields):
            raise KeyError(f"{self.name} takes {list(self.fields)}, got {sorted(names)}")
        return self._fill(team, {field: check_name(field, name) for field, name in names.items()})

    def selector(self, team: str, /, **names: str) -> str:
        """The key expression of all keys of this topic; fields that are not given are `*`."""
        given = {field: check_name(field, name) for field, name in names.items()}
        return self._fill(team, {field: given.get(field, "*") for field in self.fields})

    def of_every_team(self) -> str:
        """The key expression that matches this topic in every team."""
        return "/".join((ROOT, "*", *("*" if chunk.startswith("{") else chunk for chunk in self.chunks)))

    def parse(self, key: str) -> dict[str, str] | None:
        """The names in a concrete key with its team under `team`, or None if it is not one of this topic.

        What is returned is shared with the next caller: do not write to it.
        """
        return self._parsed(key)

    @cached_property
    def _parsed(self) -> Callable[[str], dict[str, str] | None]:
        return lru_cache(maxsize=PARSED_KEYS)(self._parse)

    def _parse(self, key: str) -> dict[str, str] | None:
        parts = key.split("/")
        if len(parts) != len(self.chunks) + 2 or parts[0] != ROOT or "*" in key:
            return None
        names = {"team": parts[1]}
        for chunk, part in zip(self.chunks, parts[2:], strict=True):
            if chunk.startswith("{"):
                names[chunk[1:-1]] = part
            elif chunk != part:
                return None
        return names

    def json_schema(self) -> dict[str, Any]:
        """JSON Schema of the payload."""
        return msgspec.json.schema(self.message) if self.message is not None else {}

    def _fill(self, team: str, names: Mapping[str, str]) -> str:
        filled = (names[chunk[1:-1]] if chunk.startswith("{") else chunk for chunk in self.chunks)
        return "/".join((ROOT, check_name("team", team), *filled))


def _reader(message: Any, field: str) -> Callable[[Any], str]:
    kind = next(one.type for one in msgspec.structs.fields(message) if one.name == field)
    return attrgetter(field) if get_origin(kind) is Annotated else attrgetter(f"{field}.id")  # a task has an id
