"""Sends the replies to a query: an error, or what was held back until something else had happened."""

import logging
from typing import Any

import msgspec
import zenoh

from robrain.protocol.wire.errors import CallError
from robrain.protocol.wire.topic import JSON, Query

logger = logging.getLogger(__name__)


def reply_error(query: zenoh.Query, error: CallError) -> None:
    """Reply an error; the query stays open."""
    query.reply_err(msgspec.json.encode(error.reply()), encoding=JSON)


def reply_deferred(
    query: zenoh.Query, key: str, topic: Query[Any, Any], reply: object, error: CallError | None
) -> None:
    """Reply `error`, or `reply` if there is none, and end the query; nothing is sent if the session has closed."""
    with query:
        try:
            if error is not None:
                reply_error(query, error)
            else:
                query.reply(key, topic.payloads.write(reply), encoding=topic.encoding)
        except zenoh.ZError as closed:
            logger.debug("%s: no reply can be sent any more: %s", key, closed)
