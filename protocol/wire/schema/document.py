"""The whole wire as one JSON document: all topics, queries and tokens, with the schemas of all they carry."""

from importlib.metadata import version
from types import NoneType
from typing import Any

from robrain.protocol.wire.errors import ErrorCode, ErrorReply
from robrain.protocol.wire.keys import NAME_PATTERN, ROOT
from robrain.protocol.wire.schema.json_schema import DIALECT, definitions, reference_to
from robrain.protocol.wire.topic import JSON, Query, Token, Topic, WireKey
from robrain.protocol.wire.topics import TOPICS

ABOUT = (
    f"Zenoh keys below `{ROOT}/{{team}}/`; names in braces are filled in. A topic is published, a query is answered, a "
    "token is a liveliness token. Payloads are JSON unless `encoding` says otherwise."
)
COMMON_ERRORS = {
    ErrorCode.BAD_ARGUMENTS: "The request is too large, does not decode, or holds a value out of range.",
    ErrorCode.BUSY: "Too many queries wait already, or somebody has exclusive use of it.",
    ErrorCode.FAILED: "What was asked for was tried and failed.",
    ErrorCode.UNLOADED: "The component has stopped.",
    ErrorCode.TIMEOUT: "No reply in time.",
}
"""What every query may be answered with."""
OTHER_ERRORS = {
    ErrorCode.UNKNOWN_PLUGIN: "The robot has no plugin of that name.",
    ErrorCode.UNKNOWN_FUNCTION: "The plugin, or the host, has no function of that name.",
    ErrorCode.FORBIDDEN: "The plugin may not be called from outside.",
    ErrorCode.HALTED: "The plugin is halted.",
    ErrorCode.INACTIVE: "The plugin does not run.",
    ErrorCode.REFUSED: "It is understood and not done; the message says why.",
}


def wire_document() -> dict[str, Any]:
    """The wire in the terms of JSON Schema: enough to write a client in any language."""
    return {
        "$schema": DIALECT,
        "title": "robrain wire",
        "version": version("robrain"),
        "description": ABOUT,
        "names": {"type": "string", "pattern": f"^{NAME_PATTERN}$"},
        "topics": [_row(row) for row in TOPICS if isinstance(row, Topic)],
        "queries": [_row(row) for row in TOPICS if isinstance(row, Query)],
        "tokens": [_row(row) for row in TOPICS if isinstance(row, Token)],
        "errors": {str(code): meaning for code, meaning in (COMMON_ERRORS | OTHER_ERRORS).items()},
        "error_reply": reference_to(ErrorReply),
        "$defs": definitions(),
    }


def key_of(row: WireKey) -> str:
    """The key with its root and its team."""
    return f"{ROOT}/{{team}}/{row.pattern}"


def schema_or_none(kind: Any) -> dict[str, Any] | None:
    """The schema of what travels, which refers to `$defs`; None for nothing, any JSON for bytes."""
    if kind in (None, NoneType):
        return None
    return {} if kind is bytes else reference_to(kind)


def errors_of(row: Query[Any, Any]) -> list[str]:
    """The codes of the errors that a query may be answered with."""
    return [str(code) for code in (*COMMON_ERRORS, *row.errors)]


def _row(row: WireKey) -> dict[str, Any]:
    said: dict[str, Any] = {"name": row.name, "key": key_of(row), "description": row.doc, "by": str(row.by)}
    if isinstance(row, Topic):
        return said | {
            "message": schema_or_none(row.message),
            "encoding": row.encoding,
            "rate_hz": row.rate_hz,
            "delivery": str(row.delivery),
            "priority": str(row.urgency),
            "max_bytes": row.max_bytes,
            "recorded": row.recorded,
        }
    if isinstance(row, Query):
        return said | {
            "request": schema_or_none(row.request),
            "reply": schema_or_none(row.reply) if row.encoding == JSON else None,
            "encoding": row.encoding,
            "errors": errors_of(row),
            "timeout_s": row.timeout_s,
            "priority": str(row.urgency),
            "max_request_bytes": row.max_request_bytes,
            "max_reply_bytes": row.max_reply_bytes,
            "reads_only": row.reads_only,
        }
    return said
