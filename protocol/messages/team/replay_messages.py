"""Messages that control a replay, and its status."""

import msgspec

from robrain.protocol.model.ranges import Seconds, Speed


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
