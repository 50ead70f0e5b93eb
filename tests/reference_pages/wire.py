"""The page of topics, queries and tokens, from the table in `protocol/wire/topics.py`."""

from types import NoneType
from typing import get_args, get_origin

import msgspec

from robrain.protocol.wire.topic import JSON, Delivery, Query, Token, Topic
from robrain.protocol.wire.topics import PUBLISHED, TOPICS
from tests.reference_pages.markdown import page, table

INTRODUCTION = """\
Everything that passes between robots, coordinator, arena, recorder and dashboard. All keys are below `robrain/{team}/`.
A *topic* is published, a *query* is answered, and a *token* (Zenoh liveliness) says that its owner is present. Payloads
are JSON unless stated otherwise.
"""
TOPIC_WORDS = """\
Delivery:

- *latest*: only the last sample of a key counts.
- *every*: each sample counts; none is sent again.
- *lossless*: in live, the sender keeps the given number of samples, sends them again after a lost connection, and late
  joiners receive them. In lockstep nothing is lost.
"""
QUERY_WORDS = """\
Every query is answered: with its reply, or with `{"code", "message", "detail"}` as an error. An empty request counts as
`{}`. A request that is larger than a megabyte (unless stated otherwise), does not decode, or holds a value out of range
is answered `bad_arguments`, and counted. *free JSON*: the two ends agree on the types, as for the arguments of a
plugin's function.
"""
MESSAGE_WORDS = "Fields in italics have a default. `protocol/wire/messages.py` documents each field."


def topics_page() -> str:
    """The whole of docs/reference/topics.md."""
    parts = [
        f"## Topics\n\n{TOPIC_WORDS}\n{topics_table()}",
        f"## Queries\n\n{QUERY_WORDS}\n{queries_table()}",
        f"## Tokens\n\n{tokens_table()}",
        f"## Messages\n\n{MESSAGE_WORDS}\n\n{messages_table()}",
    ]
    return page("Topics and queries", INTRODUCTION, *parts)


def topics_table() -> str:
    """The topics, in markdown."""
    rows = []
    for topic in PUBLISHED:
        rate = f"{topic.rate_hz:g} Hz" if topic.rate_hz is not None else "–"
        recorded = "yes" if topic.recorded else "–"
        payload, delivery = _payload(topic), _delivery(topic)
        rows.append((f"`{topic.pattern}`", topic.doc, topic.by, payload, rate, delivery, topic.urgency, recorded))
    return table(("key", "what", "by", "payload", "rate", "delivery", "urgency", "recorded"), rows)


def queries_table() -> str:
    """The queries, in markdown."""
    rows = []
    for row in TOPICS:
        if isinstance(row, Query):
            changes = "–" if row.reads_only else "yes"
            reply = _type(row.reply) if row.encoding == JSON else row.encoding
            rows.append((f"`{row.pattern}`", row.doc, row.by, _type(row.request), reply, changes))
    return table(("key", "what", "by", "request", "reply", "changes something"), rows)


def tokens_table() -> str:
    """The tokens, in markdown."""
    rows = [(f"`{row.pattern}`", row.doc, row.by) for row in TOPICS if isinstance(row, Token)]
    return table(("key", "what", "by"), rows)


def messages_table() -> str:
    """The messages, requests and replies with their fields, in markdown; those with a default are in italics."""
    said = [topic.message for topic in PUBLISHED]
    said += [kind for row in TOPICS if isinstance(row, Query) for kind in (row.request, row.reply)]
    structs = [one for kind in said for one in (kind, *get_args(kind)) if hasattr(one, "__struct_fields__")]
    rows = []
    for message in dict.fromkeys(structs):
        fields = (_field(field) for field in msgspec.structs.fields(message))
        rows.append((f"`{message.__name__}`", ", ".join(fields)))
    return table(("message", "fields"), rows)


def _field(field: msgspec.structs.FieldInfo) -> str:
    return f"`{field.name}`" if field.required else f"*{field.name}*"


def _payload(topic: Topic) -> str:
    if topic.encoding != JSON:
        return topic.encoding.removeprefix("application/vnd.robrain.")
    return f"`{topic.message.__name__}`" if topic.message is not None else "–"


def _type(kind: object) -> str:
    if kind is bytes:
        return "free JSON"
    if kind is NoneType:
        return "–"
    inner = get_args(kind)
    if get_origin(kind) is list:
        return f"list of {_type(inner[0])}"
    if get_origin(kind) is dict:
        return "object of numbers"
    return f"{_type(inner[0])} or null" if inner else f"`{kind.__name__}`"


def _delivery(topic: Topic) -> str:
    words = [f"{topic.delivery}, {topic.cache}" if topic.delivery is Delivery.LOSSLESS else str(topic.delivery)]
    words += ["waits where the network is congested"] * topic.is_blocking
    words += [f"at most {topic.max_bytes} bytes"] * (topic.max_bytes is not None)
    return "; ".join(words)
