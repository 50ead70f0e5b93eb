"""State of a recording while it is written."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.messages.message import Message
from robrain.protocol.model.ranges import Count, Name, Seconds, Speed, Text
from robrain.protocol.refusals import Refused
from robrain.protocol.topic import Delivery, Query, Topic, Urgency


class LostMessages(msgspec.Struct, frozen=True):
    """Messages of one topic that are not in a recording."""

    topic: Name
    """Its name in the table."""
    messages: Count
    """How many."""


class RecorderState(Message, frozen=True, kw_only=True):
    """Status of a recorder: every second in live, and when something was lost."""

    recorder: Name
    """Name of the recorder."""
    file: Text = ""
    """Name of the file that it writes to."""
    messages: Count = 0
    """Messages received."""
    bytes: Count = 0
    """Bytes written up to now."""
    lost: Annotated[list[LostMessages], Meta(max_length=1000)] = msgspec.field(default_factory=list)
    """Messages that are not in the recording."""
    refused: Refused = msgspec.UNSET
    """Messages that are not in the recording because they break the contract of their topic."""
    waiting: Count = 0
    """Messages received that are not written yet."""
    why: Text = ""
    """Its problem; empty if there is none."""
    closed: bool = False
    """It has finished its file."""
    removed: Count | msgspec.UnsetType = msgspec.UNSET
    """Older files that it has removed to make room; absent if it removes none."""


class ReplayRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A query to a replay. A field that is None changes nothing; an empty request only reads the status."""

    playing: bool | None = None
    """False pauses it."""
    seek_s: Seconds | None = None
    """Position to go to, seconds since the first message; the state at that time is published."""
    speed: Speed | None = None
    """Recorded seconds per second, above 0."""


class ReplayStatus(msgspec.Struct, frozen=True, kw_only=True):
    """Position and speed of a replay."""

    position_s: Seconds
    """Where the replay is, from the start of the recording."""
    duration_s: Seconds
    speed: Speed
    """Seconds of the recording per second."""
    playing: bool
    """Whether it moves."""


RECORDER_STATE = Topic(
    "recorder/{recorder}/state", "State of a recorder, with lost messages", RecorderState, rate_hz=1, periods_max=3,
    delivery=Delivery.LATEST, urgency=Urgency.DATA_LOW, max_bytes=65_536)  # fmt: skip
REPLAY_CONTROL = Query(
    "replay/control", "Pause a replay, seek in it, change its speed: replies a `ReplayStatus`", ReplayRequest,
    ReplayStatus, urgency=Urgency.INTERACTIVE_HIGH)  # fmt: skip
