"""The wire as a page of documentation, in markdown."""

from collections.abc import Iterable
from typing import Any, get_origin

from robrain.protocol.schema.document import COMMON_ERRORS, OTHER_ERRORS, schema_or_none
from robrain.protocol.schema.struct_schema import Schema, definitions
from robrain.protocol.table.topics import all_rows, all_topics
from robrain.protocol.topic import JSON, Delivery, Query, Token, Topic

INTRODUCTION = """\
# Topics and queries

<!-- Generated: `robrain wire --format markdown` writes this page. Do not edit it. -->

Everything that passes between robots, coordinator, arena, recorder and dashboard. All keys are below `robrain/{team}/`.
A *topic* is published, a *query* is answered, and a *token* (Zenoh liveliness) says that its owner is present. Payloads
are JSON unless stated otherwise. For programs: `robrain wire --format jsonschema` prints the same as one JSON document.
[Talk to a team from any language](../how-to/any-language.md) shows how a client uses them.

A message is refused if it is larger than its topic allows or does not decode. It is also refused if a value is out of
range, or if it names another sender than its key. Refused messages are counted by topic, sender and reason;
`robrain status`, the log and the dashboard show them. A stamp more than 5 s ahead of the receiver's clock, or more than
60 s behind it, is by a clock that differs. Receivers then count the times in the message from its arrival.
"""

TOPIC_WORDS = """\
Delivery:

- *latest*: only the last sample of a key counts.
- *every*: each sample counts; none is sent again.
- *lossless*: in live, the sender keeps the given number of samples, sends them again after a lost connection, and late
  joiners receive them. In lockstep nothing is lost.
"""

QUERIES = """\
Every query is answered: with its reply, or with an error, an `ErrorReply`. An empty request counts as `{}`. A request
that is too large, does not decode, or holds a value out of range is answered `bad_arguments`, and counted. *free JSON*:
the two ends agree on the types, as for the arguments of a plugin's function.

An installed distribution may add verbs under `robot/{robot}/host/VERB`, by entry points in the group
`robrain.host_verbs`. Their requests and replies are JSON. A verb that the robot does not have is answered
`unknown_function`, with those that it has.
"""

FIELDS = "Fields in italics have a default and may be left out. Unknown fields are ignored."


def wire_page() -> str:
    """The page."""
    parts = (
        INTRODUCTION,
        f"## Topics\n\n{TOPIC_WORDS}",
        topics_table(),
        f"## Queries\n\n{QUERIES}",
        queries_table(),
        "### Errors\n",
        errors_table(),
        "## Tokens\n",
        tokens_table(),
        f"## Messages\n\n{FIELDS}\n",
        *(message_section(name, schema) for name, schema in sorted(definitions().items())),
    )
    return "\n".join(parts)


def topics_table() -> str:
    """The topics."""
    rows = []
    for topic in all_topics():
        rate = f"{topic.rate_hz:g} Hz" if topic.rate_hz is not None else "–"
        recorded = "yes" if topic.recorded else "–"
        limit = _bytes(topic.max_bytes)
        payload = _type(topic.message) if topic.encoding == JSON else _encoding(topic.encoding)
        rows.append(
            (f"`{topic.pattern}`", topic.doc, topic.by, payload, limit, rate, _delivery(topic), topic.urgency, recorded)
        )
    return _table(("key", "what", "by", "payload", "at most", "rate", "delivery", "urgency", "recorded"), rows)


def queries_table() -> str:
    """The queries."""
    rows = []
    for row in all_rows():
        if isinstance(row, Query):
            changes = "–" if row.reads_only else "yes"
            reply = _type(row.reply) if row.encoding == JSON else _encoding(row.encoding)
            errors = ", ".join(f"`{code}`" for code in row.errors) or "–"
            asked = _type(row.request)
            rows.append((f"`{row.pattern}`", row.doc, row.by, asked, reply, errors, f"{row.timeout_s:g} s", changes))
    return _table(("key", "what", "by", "request", "reply", "errors", "wait", "changes something"), rows)


def errors_table() -> str:
    """The codes of errors."""
    rows = [(f"`{code}`", meaning, "every query") for code, meaning in COMMON_ERRORS.items()]
    rows += [(f"`{code}`", meaning, "as said above") for code, meaning in OTHER_ERRORS.items()]
    return _table(("code", "meaning", "of"), rows)


def tokens_table() -> str:
    """The tokens."""
    rows = [(f"`{row.pattern}`", row.doc, row.by) for row in all_rows() if isinstance(row, Token)]
    return _table(("key", "what", "by"), rows)


def message_section(name: str, schema: Schema) -> str:
    """A message, request, reply or part of one, with its fields."""
    about = " ".join(schema.get("description", "").partition(">>>")[0].split())
    needed = schema.get("required", [])
    rows = []
    for field, part in schema.get("properties", {}).items():
        unit = part.get("$comment", "").removeprefix("unit: ") or "–"
        shown = f"`{field}`" if field in needed else f"*`{field}`*"
        rows.append((shown, schema_text(part), unit, range_text(part), part.get("description", "")))
    if "enum" in schema:
        values = ", ".join(f"`{value}`" for value in schema["enum"])
        return f"### {name}\n\n{about}\n\nOne of {values}.\n"
    table = _table(("field", "type", "unit", "range", "meaning"), rows) if rows else ""
    return f"### {name}\n\n{about}\n\n{table}"


def schema_text(schema: Schema) -> str:
    """The type that a schema describes, in few words."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(schema_text(one) for one in schema["anyOf"]))
    if "enum" in schema:
        return " or ".join(f"`{value}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    kind = schema.get("type", "any")
    if kind == "array":
        items = schema.get("items") or (schema.get("prefixItems") or [{}])[0]
        return f"list of {schema_text(items) if isinstance(items, dict) and items else 'any'}"
    if kind == "string" and "contentEncoding" in schema:
        return str(schema["contentEncoding"])
    return str(kind)


def range_text(schema: Schema) -> str:
    """The bounds of a number, the length of a text or list, in few words."""
    for option in schema.get("anyOf", ()):
        if option.get("type") != "null" and (words := range_text(option)) != "–":
            return words
    low = schema.get("minimum", schema.get("exclusiveMinimum"))
    high = schema.get("maximum", schema.get("exclusiveMaximum"))
    if low is not None or high is not None:
        return f"{'' if low is None else f'{low:g}'} … {'' if high is None else f'{high:g}'}".strip()
    most = schema.get("maxLength", schema.get("maxItems", schema.get("maxProperties")))
    return f"≤ {most}" if most is not None else "–"


def _delivery(topic: Topic[Any]) -> str:
    words = f"{topic.delivery}, {topic.cache}" if topic.delivery is Delivery.LOSSLESS else str(topic.delivery)
    return f"{words}; waits where the network is congested" if topic.is_blocking else words


def _type(kind: Any) -> str:
    if kind is bytes:
        return "free JSON"
    if get_origin(kind) is dict:
        return "object of numbers"
    schema = schema_or_none(kind)
    return "–" if schema is None else schema_text(schema)


def _encoding(encoding: str) -> str:
    return encoding.removeprefix("application/vnd.robrain.")


def _bytes(size: int) -> str:
    """A size in bytes, with a binary prefix.

    >>> _bytes(4096), _bytes(16_777_216)
    ('4 KiB', '16 MiB')
    """
    kibibytes = size // 1024
    return f"{kibibytes} KiB" if kibibytes < 1024 else f"{kibibytes // 1024} MiB"


def _table(titles: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> str:
    lines: list[tuple[object, ...]] = [titles, ("---",) * len(titles), *rows]
    return "".join(f"| {' | '.join(str(cell).replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)
