"""The table `[motes.mesh]` of a scenario: motes that pass on readings of their neighbours."""

import math

import msgspec

from robrain.protocol.model.ranges import check_positive, check_within
from robrain.protocol.tinyos.forwarded import HOPS_MAX

QUEUE_MAX = 1024


class MeshSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[motes.mesh]`: readings that travel over neighbours to a robot or gateway. All defaults are chosen.

    Raises ValueError where a number is out of range.
    """

    hops: int = 0
    """Largest number of motes that pass a reading on; 0: motes do not hear each other."""
    tries: int = 4
    """Packets in a row that a next hop may leave unacknowledged before the mote pauses, each time for longer."""
    queue: int = 16
    """Readings that a mote holds to pass them on; it acknowledges none while it has no room."""
    duty: float = 0.01
    """Share of the time in which a mote listens for its neighbours, at moments that they know."""
    wake_s: float = 0.5
    """Interval of these moments, which a reading waits at each mote that passes it on."""
    routes_s: float = 30.0
    """Interval at which motes choose their next hops again; each sends a beacon for it and hears its neighbours'."""

    def __post_init__(self) -> None:
        check_within(self, 0, HOPS_MAX, "hops")
        check_within(self, 1, 255, "tries")
        check_within(self, 1, QUEUE_MAX, "queue")
        check_within(self, 0, 1, "duty")
        check_positive(self, "wake_s", "routes_s", below=math.inf)
