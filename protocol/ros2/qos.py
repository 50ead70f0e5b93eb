"""Quality of service of ROS 2, and its form in tokens of `rmw_zenoh`.

A token holds `reliability:durability:history,depth:deadline:lifespan:liveliness,lease` with the numbers of rmw's enums.
Defaults of rmw_zenoh are omitted, and here also deadline, lifespan and lease.
"""

from enum import IntEnum

import msgspec

DEFAULT_DEPTH = 42
"""Of rmw_zenoh, for a depth of 0."""


class Reliability(IntEnum):
    """`rmw_qos_reliability_policy_e`."""

    RELIABLE = 1
    BEST_EFFORT = 2


class Durability(IntEnum):
    """`rmw_qos_durability_policy_e`."""

    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class History(IntEnum):
    """`rmw_qos_history_policy_e`."""

    KEEP_LAST = 1
    KEEP_ALL = 2


class Qos(msgspec.Struct, frozen=True):
    """Quality of service of one publisher, subscription or server.

    >>> Qos(durability=Durability.TRANSIENT_LOCAL, depth=1).token
    ':1:,1:,:,:,,'
    """

    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE
    history: History = History.KEEP_LAST
    depth: int = 10

    @property
    def is_latched(self) -> bool:
        """Whether late subscriptions get the last messages."""
        return self.durability is Durability.TRANSIENT_LOCAL

    @property
    def token(self) -> str:
        """Fields of a token."""
        reliability = "" if self.reliability is Reliability.RELIABLE else str(int(self.reliability))
        durability = "" if self.durability is Durability.VOLATILE else str(int(self.durability))
        history = "" if self.history is History.KEEP_LAST else str(int(self.history))
        depth = "" if self.depth in (0, DEFAULT_DEPTH) else str(self.depth)
        return f"{reliability}:{durability}:{history},{depth}:,:,:,,"


RELIABLE = Qos()
"""As rclpy's default, also for services: the last 10."""
SENSOR_DATA = Qos(Reliability.BEST_EFFORT, depth=5)
"""`qos_profile_sensor_data`."""
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
"""The last message, also for those that come later: maps."""
TF = Qos(depth=100)
