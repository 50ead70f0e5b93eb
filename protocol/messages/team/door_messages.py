"""Doors that robots have opened."""

from enum import StrEnum

from robrain.protocol.messages.message import Message
from robrain.protocol.model.ranges import Name, Seconds, Text
from robrain.protocol.topic import Delivery, Topic, Urgency


class DoorPosition(StrEnum):
    """Position of a door."""

    OPEN = "open"
    CLOSED = "closed"
    """Not open: it may be moving."""
    FAILED = "failed"
    """It was not open in time, or its controller does not answer; robots avoid it until it opens again."""


class DoorState(Message, frozen=True, kw_only=True):
    """A door, after a change and once a second. Robots request it in their states (`reservations`)."""

    door: Name
    """The name of its zone."""
    position: DoorPosition
    """As its controller reports it."""
    opening_s: Seconds = 0.0
    """Time that it usually takes to open."""
    why: Text = ""
    """Cause of a failure, for people."""


DOOR_STATE = Topic(
    "door/{door}/state", "Position of a door", DoorState, rate_hz=1, delivery=Delivery.LATEST,
    urgency=Urgency.DATA_HIGH, recorded=True)  # fmt: skip
