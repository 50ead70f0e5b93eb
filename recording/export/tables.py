"""Messages as rows: the columns of a topic, and a row for each of its messages.

Columns come from the type of the topic's message, so that they are the same for every recording: `pose.x_m`,
`battery.soc`. Lists, free JSON and fields of which tasks of different kinds have different types are JSON text.
"""

import types
from collections.abc import Sequence
from enum import StrEnum
from typing import Any, NamedTuple, Union, get_args, get_origin

import msgspec

from robrain.protocol.clock import to_seconds
from robrain.protocol.topic import Topic
from robrain.recording.reader.recorded_message import RecordedMessage


class Cell(StrEnum):
    """The type of a column; values of all but `t_s` may be missing."""

    INT = "int"
    FLOAT = "float"
    BOOL = "bool"
    TEXT = "text"
    JSON = "json"
    """JSON text."""


class Column(NamedTuple):
    """One column of a topic's table."""

    name: str
    cell: Cell
    path: tuple[str, ...]
    """Fields that lead to it, in the message."""


TIME = Column("t_s", Cell.FLOAT, ())
KEY = Column("wire_key", Cell.TEXT, ())
PAYLOAD_BYTES = Column("payload_bytes", Cell.INT, ())
Row = list[Any]
INT_MAX = 2**63 - 1
"""A whole number beyond a table's range is skipped; only a hostile sender has any."""


class Table:
    """Makes rows of the messages of one topic.

    Args:
        topic: a row of the table of topics.
        start_ns: the run's clock at time 0.
    """

    def __init__(self, topic: Topic[Any], start_ns: int) -> None:
        self.topic = topic
        self._start_ns = start_ns
        fields = [] if topic.message is None else columns_of(topic.message)
        self._fields = fields
        names = [Column(name, Cell.TEXT, ()) for name in topic.fields if name not in {field.name for field in fields}]
        self._names = [column.name for column in names]
        self.columns: list[Column] = [TIME, KEY, *names, *(fields or [PAYLOAD_BYTES])]

    def row(self, message: RecordedMessage) -> Row | None:
        """The message as a row, or None if it does not fit its topic."""
        names = self.topic.parse(message.topic_key) or {}
        row: Row = [to_seconds(message.log_time_ns - self._start_ns), message.topic_key]
        row += [names.get(name) for name in self._names]
        if self.topic.message is None:
            return [*row, len(message.payload)]
        # Decoded as its type, so that a field missing in an older recording has its default.
        if (decoded := self.topic.payloads.read_if_valid(message.payload)) is None:
            return None
        built = msgspec.to_builtins(decoded)
        return row + [_cell(built, column) for column in self._fields]


def columns_of(message: Any) -> list[Column]:
    """The columns of a message type, nested structs with dots in their names."""
    return _struct_columns([message], ())


def _struct_columns(kinds: Sequence[Any], path: tuple[str, ...]) -> list[Column]:
    """Columns of one struct, or of several of which a field holds one: those of all, each once."""
    found: dict[str, list[Any]] = {}
    tagged = [kind.__struct_config__.tag_field for kind in kinds if kind.__struct_config__.tag_field]
    for kind in kinds:
        for field in msgspec.structs.fields(kind):
            found.setdefault(field.encode_name, []).append(field.type)
    columns = [Column(".".join((*path, tagged[0])), Cell.TEXT, (*path, tagged[0]))] if tagged else []
    for name, hints in found.items():
        columns += _field_columns(hints, (*path, name))
    return columns


def _field_columns(hints: Sequence[Any], path: tuple[str, ...]) -> list[Column]:
    kinds = {kind for hint in hints for kind in _members(hint)} - {type(None)}
    structs = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, msgspec.Struct)]
    if structs and len(structs) == len(kinds):
        ordered = sorted(structs, key=lambda kind: kind.__name__)
        return _struct_columns(ordered, path)
    cells = {_plain_cell(kind) for kind in kinds}
    cell = cells.pop() if len(cells) == 1 else Cell.FLOAT if cells <= {Cell.INT, Cell.FLOAT} else Cell.JSON
    return [Column(".".join(path), cell, path)]


def _members(hint: Any) -> tuple[Any, ...]:
    if get_origin(hint) in (Union, types.UnionType):
        return tuple(member for part in get_args(hint) for member in _members(part))
    origin = get_origin(hint)
    return (hint if origin is None or origin in (list, tuple, dict) else get_args(hint)[0],)


def _plain_cell(kind: Any) -> Cell:
    if not isinstance(kind, type):
        return Cell.JSON
    if issubclass(kind, bool):
        return Cell.BOOL
    if issubclass(kind, int):
        return Cell.INT
    if issubclass(kind, float):
        return Cell.FLOAT
    return Cell.TEXT if issubclass(kind, (str, bytes)) else Cell.JSON


def _cell(decoded: Any, column: Column) -> Any:
    value = decoded
    for name in column.path:
        value = value.get(name) if isinstance(value, dict) else None
        if value is None:
            return None
    if column.cell is Cell.INT and not -INT_MAX - 1 <= value <= INT_MAX:
        return None
    return msgspec.json.encode(value).decode() if column.cell is Cell.JSON else value
