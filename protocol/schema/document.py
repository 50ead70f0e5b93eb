"""The whole wire as one JSON document: all topics, queries and tokens, with the schemas of all messages."""

from importlib.metadata import version
from types import NoneType
from typing import Any

from robrain.protocol.answers.asked import BY
from robrain.protocol.answers.later import ZENOH_TIMEOUT
from robrain.protocol.clock import AHEAD_S, BEHIND_S
from robrain.protocol.errors import ErrorCode, ErrorReply
from robrain.protocol.keys import DEFAULT_TEAM, NAME_PATTERN, ROOT
from robrain.protocol.schema.struct_schema import DIALECT, definitions, reference_to
from robrain.protocol.table.topics import HOST_VERB, all_rows
from robrain.protocol.topic import JSON, Delivery, Query, Token, Topic, WireKey

ABOUT = (
    f"Zenoh keys below `{ROOT}/{{team}}/`; names in braces are filled in. A topic is published, a query is answered, a "
    "token is a liveliness token. Payloads are JSON unless `encoding` says otherwise."
)
USE = {
    "session": "Open a Zenoh session in mode `client` that connects to the endpoint of the team's hub, which "
    "`robrain up` prints: `mode` and `connect/endpoints` in Zenoh's configuration.",
    "topics": "Subscribe to the key, with `*` in place of each name that is left open; the names of a sample are in "
    "its key. Publish with the encoding, priority and congestion control of the topic. Of stamped messages, set "
    "`stamp_ns` to the time and count `seq` up from 0.",
    "delivery": "`latest`: only the last sample of a key counts. `every`: samples are dropped, not sent again, if they "
    "cannot be delivered. `lossless`: the sender keeps the last `cache` samples; a plain subscriber receives what is "
    "published from then on, an advanced subscriber (zenoh-ext) with history and recovery also what is kept.",
    "queries": "A get on one concrete key, with the request as its payload and `timeout_s` as its timeout; no payload "
    "counts as `{}`. A reply that is no error holds `reply`: the request was accepted. An error reply holds "
    f"`error_reply`, or the plain text `{ZENOH_TIMEOUT.decode()}` of Zenoh itself if nobody has replied in time. If "
    "the get ends without a reply, nobody answers the key.",
    "asker": f"The selector parameter `{BY}`, as in `KEY?{BY}=ann`, says who asks; calls to a plugin that somebody "
    "holds are accepted from the holder alone.",
    "plugins": "Functions of plugins are called by `robot_call`. `robot_plugins` lists them with the JSON Schemas of "
    "their parameters and results.",
    "host_verbs": "A verb that another distribution adds to a robot's host has the key "
    f"`{ROOT}/{{team}}/{HOST_VERB.pattern}`, with a JSON object as its request and JSON as its reply. A verb that the "
    f"robot does not have is answered `{ErrorCode.UNKNOWN_FUNCTION}`, with those that it has in the message.",
    "halt": "A halt is published again until the states of all robots say `halted`; whoever halts may end it in the "
    "same way.",
    "tokens": "A liveliness get on the key, with `*` in place of each name, replies the tokens that are there; a "
    "liveliness subscriber receives a put for each that comes and a delete for each that goes. Tokens have no "
    "payload; the names are in the key.",
    "refusals": "A message is refused, and counted, if it is larger than `max_bytes`, is not valid, or names another "
    "sender than its key.",
    "clocks": f"A stamp more than {AHEAD_S:g} s ahead of the receiver's clock, or more than {BEHIND_S:g} s behind it, "
    "is by a clock that differs. Receivers then count the times in the message from its arrival.",
    "fields": "Fields that are not required may be left out; unknown fields are ignored.",
}
"""How a client uses the rows in terms of Zenoh."""
COMMON_ERRORS = {
    ErrorCode.BAD_ARGUMENTS: "The request is too large, does not decode, or holds a value out of range.",
    ErrorCode.BUSY: "Too many queries wait already, or somebody has exclusive use of it.",
    ErrorCode.FAILED: "What was asked for was tried and failed.",
    ErrorCode.UNLOADED: "The component has stopped.",
    ErrorCode.TIMEOUT: "No reply in time.",
}
"""Possible replies to every query."""
OTHER_ERRORS = {
    ErrorCode.UNKNOWN_PLUGIN: "The robot has no plugin of that name.",
    ErrorCode.UNKNOWN_FUNCTION: "The plugin, or the host, has no function of that name.",
    ErrorCode.FORBIDDEN: "The plugin may not be called from outside.",
    ErrorCode.HALTED: "The plugin is halted.",
    ErrorCode.INACTIVE: "The plugin does not run.",
    ErrorCode.REFUSED: "The request is valid but refused; the message contains the reason.",
}


def wire_document() -> dict[str, Any]:
    """The wire in the terms of JSON Schema: enough to write a client in any language."""
    return {
        "$schema": DIALECT,
        "title": "robrain wire",
        "version": version("robrain"),
        "description": ABOUT,
        "use": USE,
        "default_team": DEFAULT_TEAM,
        "names": {"type": "string", "pattern": f"^{NAME_PATTERN}$"},
        "topics": [_row(row) for row in all_rows() if isinstance(row, Topic)],
        "queries": [_row(row) for row in all_rows() if isinstance(row, Query)],
        "tokens": [_row(row) for row in all_rows() if isinstance(row, Token)],
        "errors": {str(code): meaning for code, meaning in (COMMON_ERRORS | OTHER_ERRORS).items()},
        "error_reply": reference_to(ErrorReply),
        "$defs": definitions(),
    }


def key_of(row: WireKey) -> str:
    """The key with its root and its team."""
    return f"{ROOT}/{{team}}/{row.pattern}"


def schema_or_none(kind: Any) -> dict[str, Any] | None:
    """The schema of a message, which refers to `$defs`; None for nothing, any JSON for bytes."""
    if kind in (None, NoneType):
        return None
    return {} if kind is bytes else reference_to(kind)


def errors_of(row: Query[Any, Any]) -> list[str]:
    """The codes of the errors that a query may be answered with."""
    return [str(code) for code in (*COMMON_ERRORS, *row.errors)]


def _row(row: WireKey) -> dict[str, Any]:
    described: dict[str, Any] = {"name": row.name, "key": key_of(row), "description": row.doc, "by": str(row.by)}
    if isinstance(row, Topic):
        return described | {
            "message": schema_or_none(row.message),
            "encoding": row.encoding,
            "rate_hz": row.rate_hz,
            "delivery": str(row.delivery),
            "cache": row.cache if row.delivery is Delivery.LOSSLESS else 0,
            "priority": str(row.urgency),
            "congestion": "block" if row.is_blocking else "drop",
            "max_bytes": row.max_bytes,
            "recorded": row.recorded,
        }
    if isinstance(row, Query):
        return described | {
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
    return described
