"""What is asked of a recording that is replayed, and what it answers."""

import msgspec

from robrain.protocol.model.ranges import Seconds, Speed


class ReplayRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A query to a replay; what is None stays as it is. Without anything it only asks where the replay is."""

    playing: bool | None = None
    """False pauses it."""
    seek_s: Seconds | None = None
    """Go there, in seconds since the first message; all that was the case then is said."""
    speed: Speed | None = None
    """Recorded seconds a second, above 0."""


class ReplayStatus(msgspec.Struct, frozen=True, kw_only=True):
    """Where a replay is."""

    position_s: Seconds
    duration_s: Seconds
    speed: Speed
    playing: bool
