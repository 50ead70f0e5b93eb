"""The table `[motes.mesh]` of a scenario: motes that pass on readings of their neighbours."""

from typing import Annotated

from msgspec import Meta

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive, Share
from robrain.protocol.tinyos.forwarded import HOPS_MAX

QUEUE_MAX = 1024


class MeshSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[motes.mesh]`: readings that travel over neighbours to a robot or gateway. All defaults are chosen.

    Raises ValueError where a number is out of range.
    """

    hops: Annotated[int, Meta(ge=0, le=HOPS_MAX)] = 0
    """Largest number of motes that pass a reading on; 0: motes do not hear each other."""
    tries: Annotated[int, Meta(ge=1, le=255)] = 4
    """Packets in a row that a next hop may leave unacknowledged before the mote pauses, each time for longer."""
    queue: Annotated[int, Meta(ge=1, le=QUEUE_MAX)] = 16
    """Readings that a mote holds to pass them on; it acknowledges none while it has no room."""
    duty: Share = 0.01
    """Share of the time in which a mote listens for its neighbours, at moments that they know."""
    wake_s: Positive = 0.5
    """Interval of these moments, which a reading waits at each mote that passes it on."""
    routes_s: Positive = 30.0
    """Interval at which motes choose their next hops again; each sends a beacon for it and hears its neighbours'."""
