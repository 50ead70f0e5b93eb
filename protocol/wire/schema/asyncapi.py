"""The wire as an AsyncAPI 3.0 document, for its tools: viewers, generators of clients, mocks.

Operations are told from the component that owns the key: it sends its topics, and receives requests and replies.
"""

from importlib.metadata import version
from typing import Any

from robrain.protocol.wire.errors import ErrorReply
from robrain.protocol.wire.schema.document import errors_of, key_of, schema_or_none
from robrain.protocol.wire.schema.json_schema import definitions, reference_to
from robrain.protocol.wire.topic import Query, Topic, WireKey
from robrain.protocol.wire.topics import TOPICS

SCHEMAS = "#/components/schemas/"


def asyncapi_document() -> dict[str, Any]:
    """The topics and queries of the wire; its tokens, which carry nothing, as channels without messages."""
    operations: dict[str, Any] = {}
    for row in TOPICS:
        if isinstance(row, Topic | Query):
            operations[row.name] = _operation(row)
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "robrain",
            "version": version("robrain"),
            "description": "A coordinator for teams of mobile robots over Zenoh.",
            "license": {"name": "Apache-2.0"},
        },
        "defaultContentType": "application/json",
        "channels": {row.name: _channel(row) for row in TOPICS},
        "operations": operations,
        "components": {"schemas": _moved(definitions())},
    }


def _channel(row: WireKey) -> dict[str, Any]:
    names = ("team", *row.fields)
    channel: dict[str, Any] = {
        "address": key_of(row),
        "description": row.doc,
        "parameters": {name: {"description": f"Name of the {name}."} for name in names},
    }
    if isinstance(row, Topic):
        channel["messages"] = {row.name: _message(row.message or bytes, row.encoding)}
    elif isinstance(row, Query):
        channel["messages"] = {
            "request": _message(row.request),
            "reply": _message(row.reply, row.encoding),
            "error": _message(ErrorReply) | {"description": f"`code` is one of {', '.join(errors_of(row))}."},
        }
    return channel


def _operation(row: Topic[Any] | Query[Any, Any]) -> dict[str, Any]:
    reference = {"$ref": f"#/channels/{row.name}"}
    if isinstance(row, Topic):
        return {"action": "send", "channel": reference, "summary": row.doc}
    messages = {name: {"$ref": f"#/channels/{row.name}/messages/{name}"} for name in ("request", "reply", "error")}
    reply = {"channel": reference, "messages": [messages["reply"], messages["error"]]}
    told = {"action": "receive", "channel": reference, "summary": row.doc, "messages": [messages["request"]]}
    return told | {"reply": reply}


def _message(kind: Any, encoding: str = "application/json") -> dict[str, Any]:
    """A message of a type; one that holds nothing, or anything, has an empty payload schema."""
    payload = _moved(reference_to(kind) if kind is ErrorReply else schema_or_none(kind) or {})
    return {"contentType": encoding, "payload": payload}


def _moved(schema: Any) -> Any:
    """A schema whose references point into the components of the document."""
    if isinstance(schema, list):
        return [_moved(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: one.replace("#/$defs/", SCHEMAS) if key == "$ref" and isinstance(one, str) else _moved(one)
        for key, one in schema.items()
    }
