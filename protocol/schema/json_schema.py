"""JSON Schemas of the wire: of what each row of the table carries."""

from functools import cache
from types import NoneType
from typing import Any

from robrain.protocol.errors import ErrorReply
from robrain.protocol.schema.struct_schema import Schema, definitions_of
from robrain.protocol.table.topic import Query, Topic, WireKey
from robrain.protocol.table.topics import TOPICS


def types_of(row: WireKey) -> list[Any]:
    """The types of what travels under a key: message, or request and reply; bytes and nothing are left out."""
    kinds: list[Any] = []
    if isinstance(row, Topic):
        kinds = [row.message]
    elif isinstance(row, Query):
        kinds = [row.request, row.reply]
    return [kind for kind in kinds if kind not in (None, bytes, NoneType)]


@cache
def definitions() -> dict[str, Schema]:
    """The schemas of all structs of the wire by name, that of error replies among them."""
    return definitions_of([ErrorReply, *(kind for row in TOPICS for kind in types_of(row))])[1]


def reference_to(kind: Any) -> Schema:
    """The schema of one type, which refers to `definitions()`."""
    return definitions_of([kind])[0][0]
