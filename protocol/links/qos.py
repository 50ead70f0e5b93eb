"""How Zenoh carries each row of the table of topics: priority, congestion and batching, decided here alone.

Under congestion halts go before commands, commands before states, states before other telemetry, and maps and pictures
last. Only halts and queries wait for room; a put of anything else that finds its queue full is dropped by the sender's
session, so that a subscriber that reads slowly, or not at all, slows nobody.
"""

from typing import Any

import zenoh

from robrain.protocol.table.topic import Topic, Urgency

PRIORITY = {
    Urgency.REAL_TIME: zenoh.Priority.REAL_TIME,
    Urgency.INTERACTIVE_HIGH: zenoh.Priority.INTERACTIVE_HIGH,
    Urgency.DATA_HIGH: zenoh.Priority.DATA_HIGH,
    Urgency.DATA: zenoh.Priority.DATA,
    Urgency.DATA_LOW: zenoh.Priority.DATA_LOW,
    Urgency.BACKGROUND: zenoh.Priority.BACKGROUND,
}
AT_ONCE = frozenset({Urgency.REAL_TIME, Urgency.INTERACTIVE_HIGH})
"""Sent by themselves, not in batches with others: a batch waits for more."""


def publisher_options(topic: Topic[Any]) -> dict[str, Any]:
    """Arguments of Zenoh's publisher of a topic."""
    return {"encoding": topic.encoding, **_options(topic.urgency, waits=topic.is_blocking)}


def query_options(urgency: Urgency) -> dict[str, Any]:
    """Arguments of Zenoh's queries of such urgency: there is one at a time, which is to arrive."""
    return _options(urgency, waits=True)


def _options(urgency: Urgency, *, waits: bool) -> dict[str, Any]:
    control = zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP
    return {"priority": PRIORITY[urgency], "congestion_control": control, "express": urgency in AT_ONCE}
