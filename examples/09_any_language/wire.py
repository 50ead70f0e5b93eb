"""The wire of both programs in this folder, read from the output of `robrain wire --format jsonschema`."""

import itertools
import json
import re
import time
from collections import defaultdict

import zenoh

ME = "any-language"


class Refused(Exception):
    """An error reply, or no reply."""


class Wire:
    """The printed document, and a session to use it with."""

    def __init__(self, document, session):
        self.document, self.session = document, session
        self.subscribers, self.queryables = [], []
        self.numbers = defaultdict(itertools.count)
        self.rows = {row["name"]: row for kind in ("topics", "queries", "tokens") for row in document[kind]}

    def key(self, row, **names):
        """The key of a row; missing names match any."""
        filled = {"team": self.document["default_team"], **names}
        return re.sub(r"{(\w+)}", lambda found: filled.get(found[1], "*"), self.rows[row]["key"])

    def names(self, row, key):
        """The names in a concrete key."""
        return re.fullmatch(re.sub(r"{(\w+)}", r"(?P<\1>[^/]+)", self.rows[row]["key"]), str(key)).groupdict()

    def message(self, schema, **fields):
        """A message with these fields, if its schema has them and no others are required."""
        expected = resolved(schema, self.document)
        unknown, missing = fields.keys() - expected["properties"].keys(), set(expected["required"]) - fields.keys()
        if unknown or missing:
            raise TypeError(f"{expected['title']}: unknown {sorted(unknown)}, missing {sorted(missing)}")
        return fields

    def ask(self, row, request=None, **names):
        """The reply to a query; raises Refused with the error's code."""
        query = self.rows[row]
        payload = None if request is None else json.dumps(request)
        options = {"timeout": query["timeout_s"], "priority": getattr(zenoh.Priority, query["priority"].upper())}
        for reply in self.session.get(f"{self.key(row, **names)}?by={ME}", payload=payload, **options):
            if reply.ok is not None:
                return json.loads(reply.ok.payload.to_string())
            try:
                error = json.loads(reply.err.payload.to_string())
            except ValueError:  # Zenoh's own error text
                raise Refused("timeout") from None
            raise Refused(error["code"], error["message"])
        raise Refused("nobody answers")

    def listen(self, row, on_message, **names):
        """Call `on_message` with each decoded message of a topic."""

        def decode(sample):
            on_message(json.loads(sample.payload.to_string()))

        self.subscribers.append(self.session.declare_subscriber(self.key(row, **names), decode))

    def put(self, row, **fields):
        """Publish a message, under the names that its key and its fields share."""
        topic = self.rows[row]
        options = {
            "encoding": topic["encoding"],
            "priority": getattr(zenoh.Priority, topic["priority"].upper()),
            "congestion_control": getattr(zenoh.CongestionControl, topic["congestion"].upper()),
        }
        message = self.message(topic["message"], stamp_ns=time.time_ns(), seq=next(self.numbers[row]), **fields)
        self.session.put(self.key(row, **fields), json.dumps(message), **options)

    def serve(self, row, answer, **names):
        """Answer a query with the result of `answer(request)`; a ValueError is the error `refused`."""

        def reply(query):
            request = json.loads(query.payload.to_string()) if query.payload else {}
            try:
                query.reply(query.key_expr, json.dumps(answer(request)))
            except ValueError as error:
                query.reply_err(json.dumps({"code": "refused", "message": str(error)}))

        self.queryables.append(self.session.declare_queryable(self.key(row, **names), reply))

    def present(self, row):
        """The names in all tokens of a row."""
        replies = self.session.liveliness().get(self.key(row))
        return [self.names(row, reply.ok.key_expr) for reply in replies if reply.ok is not None]


def resolved(schema, root):
    """A schema, or the schema in `root` to which it refers."""
    for name in schema.get("$ref", "#").split("/")[1:]:
        root = root[name]
    return root if "$ref" in schema else schema
