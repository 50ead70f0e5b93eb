"""Sends a reply that was held back until something else had happened."""

import logging
from typing import Any

import zenoh

from robrain.protocol.answers.asked import Asked
from robrain.protocol.errors import CallError
from robrain.protocol.table.topic import Query

logger = logging.getLogger(__name__)


def reply_deferred(query: Asked, key: str, topic: Query[Any, Any], reply: object, error: CallError | None) -> None:
    """Reply `error`, or `reply` if there is none, and end the query; nothing is sent if the session has closed."""
    try:
        if error is not None:
            query.reply_error(error)
        else:
            query.reply(key, topic.payloads.write(reply), topic.encoding)
    except zenoh.ZError as closed:
        logger.debug("%s: no reply can be sent any more: %s", key, closed)
    finally:
        query.end()
