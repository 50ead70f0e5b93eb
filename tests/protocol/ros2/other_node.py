"""The view of another node: tokens of a domain, and requests to a service."""

from typing import Any

import zenoh

from robrain.protocol.ros2.message_types import ServiceType
from robrain.protocol.ros2.ros_names import data_key
from robrain.protocol.ros2.ros_node import Attachment
from tests.waiting import PATIENCE_S

GID = bytes(range(16))


class NoReply(Exception):
    """A service refuses a request, or does not answer."""


def tokens(session: zenoh.Session, kind: str = "*", domain: int = 0) -> list[str]:
    """Tokens of the entities of one kind, or of all kinds."""
    replies = session.liveliness().get(f"@ros2_lv/{domain}/*/*/*/{kind}/**", timeout=PATIENCE_S)
    return sorted({str(reply.ok.key_expr) for reply in replies if reply.ok is not None})


def ask(session: zenoh.Session, name: str, kind: ServiceType[Any, Any], request: Any, number: int = 1,
        domain: int = 0) -> Any:  # fmt: skip
    """Send a request; returns the channel of its replies, for `response`."""
    return session.get(
        data_key(domain, name, kind.name, kind.type_hash),
        payload=kind.request.encode(request),
        attachment=Attachment(number, 1, GID).pack(),
        target=zenoh.QueryTarget.ALL_COMPLETE,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=PATIENCE_S,
    )


def response(replies: Any, kind: ServiceType[Any, Any], number: int = 1) -> Any:
    """The response to a request (NoReply)."""
    for reply in replies:
        if reply.ok is None:
            raise NoReply(reply.err.payload.to_string())
        sender = Attachment.unpack(reply.ok.attachment.to_bytes())
        assert (sender.number, sender.gid) == (number, GID)
        return kind.response.decode(reply.ok.payload.to_bytes())
    raise NoReply("no server")
