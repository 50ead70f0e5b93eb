"""The rows of the table of topics: keys of the wire, their messages, and their delivery."""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from enum import StrEnum
from functools import cached_property, lru_cache
from types import UnionType
from typing import Any, ClassVar, Generic, TypeVar, cast, get_args

import msgspec

from robrain.protocol.codec import Codec
from robrain.protocol.errors import ErrorCode
from robrain.protocol.keys import ROOT, check_name, is_name

M = TypeVar("M")
"""The message of a topic."""
Q = TypeVar("Q")
"""The request of a query."""
R = TypeVar("R")
"""Its reply."""


class TopicKind(StrEnum):
    """Kind of message under a key."""

    PUT = "put"
    QUERY = "query"
    TOKEN = "token"


class Role(StrEnum):
    """Roles that publish, or answer, a topic."""

    ROBOT = "robot"
    COORDINATOR = "coordinator"
    OPERATOR = "operator"
    ARENA = "arena"


OWNERS = {
    "arena": Role.ARENA, "coordinator": Role.COORDINATOR, "door": Role.OPERATOR, "halt": Role.OPERATOR,
    "mote": Role.ROBOT, "recorder": Role.OPERATOR, "replay": Role.OPERATOR, "robot": Role.ROBOT,
    "task": Role.COORDINATOR,
}  # fmt: skip
"""Role that publishes, or answers, the keys that begin with a chunk."""


class Delivery(StrEnum):
    """Handling of samples that cannot be delivered at once."""

    LATEST = "latest"
    """Only the last one of a key counts; dropped under congestion."""
    EVERY = "every"
    """Each counts, none is sent again; dropped under congestion."""
    LOSSLESS = "lossless"
    """Kept by the sender and sent again after a cut; late joiners get the kept samples."""


class Urgency(StrEnum):
    """Zenoh priorities that are in use, most urgent first."""

    REAL_TIME = "real_time"
    """Halts."""
    INTERACTIVE_HIGH = "interactive_high"
    """Commands, calls and events."""
    DATA_HIGH = "data_high"
    """States that others decide by."""
    DATA = "data"
    """Other telemetry."""
    DATA_LOW = "data_low"
    """Maps, logs, and other messages that may be late."""
    BACKGROUND = "background"
    """Pictures, and whole copies for late joiners."""


JSON = "application/json"
CAN_FRAME = "application/vnd.robrain.can-frame"
TINYOS_PACKET = "application/vnd.robrain.tinyos-packet"
SERIAL_BYTES = "application/octet-stream"
PNG = "image/png"
ANSWER_S = 2.0
"""Time limit for a reply unless a query has another."""
REQUEST_BYTES_MAX = 1_048_576
"""Largest request that is read unless a query has another limit."""
REPLY_BYTES_MAX = 67_108_864
"""Largest reply that is read unless a query has another limit."""
MESSAGE_BYTES_MAX = 1_048_576
"""Largest message that is sent or read unless a topic has another limit."""
STAMP = "stamp_ns"
PARSED_KEYS = 4096
"""Keys of one topic whose parsed names are cached: there are few, and each arrives many times."""


@dataclass(frozen=True)
class WireKey:
    """A key of the wire; see `Topic`, `Query` and `Token`."""

    kind: ClassVar[TopicKind]
    pattern: str
    """Key below `robrain/{team}/`; `{name}` chunks are filled in."""
    doc: str
    _: KW_ONLY
    alias: str = ""
    """Its name, if that does not consist of the fixed chunks of its key."""
    role: Role | None = None
    """Role that publishes, or answers, if it is not that of the first chunk (`OWNERS`)."""
    urgency: Urgency = Urgency.DATA

    @cached_property
    def name(self) -> str:
        """Name in the table, such as `robot_map_whole` for `robot/{robot}/map/whole`."""
        return self.alias or "_".join(chunk for chunk in self.chunks if not chunk.startswith("{"))

    @cached_property
    def by(self) -> Role:
        """Role that publishes, or answers, or is present."""
        return self.role or OWNERS[self.chunks[0]]

    @cached_property
    def chunks(self) -> tuple[str, ...]:
        """The pattern, split."""
        return tuple(self.pattern.split("/"))

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Names that the key is built from, in order."""
        return tuple(chunk[1:-1] for chunk in self.chunks if chunk.startswith("{"))

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
        """The key expression of all keys of this row; fields that are not given are `*`.

        Raises:
            BadName: a name cannot be part of a key.
            KeyError: there is a name that the key does not have.
        """
        if not set(names) <= set(self.fields):
            raise KeyError(f"{self.name} takes {list(self.fields)}, got {sorted(names)}")
        given = {field: check_name(field, name) for field, name in names.items()}
        return self._fill(team, {field: given.get(field, "*") for field in self.fields})

    def intersects(self, other: "WireKey") -> bool:
        """Whether a key can be of both rows."""
        pairs = zip(self.chunks, other.chunks, strict=False)
        return len(self.chunks) == len(other.chunks) and all(one == two or "{" in one + two for one, two in pairs)

    def of_every_team(self) -> str:
        """The key expression that matches this row in every team."""
        return "/".join((ROOT, "*", *("*" if chunk.startswith("{") else chunk for chunk in self.chunks)))

    def parse(self, key: str) -> dict[str, str] | None:
        """The names in a concrete key with its team under `team`; None if it is not one of this row, or a name is bad.

        The result is shared with the next caller: do not write to it.
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
        return names if all(map(is_name, names.values())) else None

    def _fill(self, team: str, names: Mapping[str, str]) -> str:
        filled = (names[chunk[1:-1]] if chunk.startswith("{") else chunk for chunk in self.chunks)
        return "/".join((ROOT, check_name("team", team), *filled))


@dataclass(frozen=True)
class Topic(WireKey, Generic[M]):
    """Message published under a key."""

    kind: ClassVar[TopicKind] = TopicKind.PUT
    message: type[M] | None = None
    """Type of the payload; None for bytes."""
    _: KW_ONLY
    rate_hz: float | None = None
    delivery: Delivery = Delivery.EVERY
    periods_max: int = 0
    """It comes at `rate_hz` without a pause, and is stale when it is older than this number of periods; 0 if it may
    pause."""
    recorded: bool = False
    encoding: str = JSON
    max_bytes: int = MESSAGE_BYTES_MAX
    """Largest payload that publisher and receivers accept."""
    is_blocking: bool = False
    """Puts wait while the network is congested, instead of being dropped."""
    cache: int = 64
    """Samples that the sender of a lossless topic keeps."""
    earlier: str = ""
    """Pattern of its keys in recordings of earlier versions; empty if it was always the same."""

    @cached_property
    def payloads(self) -> Codec[M]:
        """Reads and writes messages; bytes go as they are."""
        return Codec(cast("type[M]", bytes) if self.message is None else self.message, self.max_bytes, self.name)

    @cached_property
    def named_twice(self) -> tuple[str, ...]:
        """Names that are in both key and payload."""
        return _in_both(self.fields, self.message)

    @cached_property
    def before(self) -> "Topic[M] | None":
        """The same topic under its earlier pattern; None without one."""
        return replace(self, pattern=self.earlier, alias=self.name, earlier="") if self.earlier else None

    @cached_property
    def deadline_s(self) -> float | None:
        """Age from which it is stale; None if it may pause for any time."""
        return self.periods_max / self.rate_hz if self.periods_max and self.rate_hz else None

    @cached_property
    def is_latest(self) -> bool:
        """Whether a sample replaces the one before of its key."""
        return self.delivery is Delivery.LATEST

    @cached_property
    def is_stamped(self) -> bool:
        """Whether messages carry the time of their sending."""
        return STAMP in _fields_of(self.message)

    @cached_property
    def is_timed(self) -> bool:
        """Whether its times are converted to the receiver's clock."""
        return hasattr(self.message, "moved_in_time")

    def json_schema(self) -> dict[str, Any]:
        """JSON Schema of the payload."""
        return msgspec.json.schema(self.message) if self.message is not None else {}


@dataclass(frozen=True)
class Query(WireKey, Generic[Q, R]):
    """Request and reply under a key.

    Requests and replies of type `bytes` are not decoded: pictures, and JSON whose types the two ends agree on.
    """

    kind: ClassVar[TopicKind] = TopicKind.QUERY
    request: type[Q]
    """Type of the request; `NoneType` if it is empty, `bytes` for free JSON. An empty payload counts as `{}`."""
    reply: type[R]
    """Type of the reply."""
    _: KW_ONLY
    reads_only: bool = False
    """It changes nothing where it is answered."""
    encoding: str = JSON
    """Of the reply."""
    errors: tuple[ErrorCode, ...] = ()
    """Errors that it may be answered with, besides those of every query."""
    timeout_s: float = ANSWER_S
    """How long to wait for the reply."""
    max_request_bytes: int = REQUEST_BYTES_MAX
    max_reply_bytes: int = REPLY_BYTES_MAX

    @cached_property
    def requests(self) -> Codec[Q]:
        """Reads and writes requests."""
        return Codec(self.request, self.max_request_bytes, f"request of {self.name}")

    @cached_property
    def payloads(self) -> Codec[R]:
        """Reads and writes replies."""
        return Codec(self.reply, self.max_reply_bytes, f"reply of {self.name}")

    is_timed: ClassVar[bool] = False
    is_latest: ClassVar[bool] = False

    @cached_property
    def named_twice(self) -> tuple[str, ...]:
        """Names that are in both key and reply."""
        return _in_both(self.fields, self.reply)


@dataclass(frozen=True)
class Token(WireKey):
    """Declares presence while it is held."""

    kind: ClassVar[TopicKind] = TopicKind.TOKEN


def _fields_of(kind: Any) -> tuple[str, ...]:
    """The fields of a struct, or of those in a union; none of any other type."""
    kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    return tuple(field for one in kinds for field in getattr(one, "__struct_fields__", ()))


def _in_both(fields: tuple[str, ...], kind: Any) -> tuple[str, ...]:
    return tuple(field for field in fields if field in _fields_of(kind))
