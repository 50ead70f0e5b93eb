"""Quality of service of ROS 2, and its form in tokens of `rmw_zenoh`.

A token holds `reliability:durability:history,depth:deadline:lifespan:liveliness,lease` with the numbers of rmw's enums;
a value that is rmw_zenoh's default is left out. Deadline, lifespan and lease are not used here: they are left at their
defaults, and read over.
"""

from enum import IntEnum

import msgspec

from robrain.protocol.ros2.errors import BadToken

DEFAULT_DEPTH = 42
"""Of rmw_zenoh, for a depth of 0."""
DEPTH_MAX = 1_000_000


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
    """Quality of service of one publisher, subscription, server or client.

    >>> LATCHED.token, Qos.from_token(":1:,1:,:,:,,") == LATCHED
    (':1:,1:,:,:,,', True)
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

    @classmethod
    def from_token(cls, text: str) -> "Qos":
        """Read the fields of a token.

        Raises:
            BadToken: it is something else.

        """
        parts = text.split(":")
        if len(parts) < 6:
            raise BadToken(f"quality of service {text[:80]!r}: expected six parts between colons, got {len(parts)}")
        history, comma, depth = parts[2].partition(",")
        try:
            return cls(
                Reliability(int(parts[0] or Reliability.RELIABLE) or Reliability.RELIABLE),
                Durability(int(parts[1] or Durability.VOLATILE) or Durability.VOLATILE),
                History(int(history or History.KEEP_LAST) or History.KEEP_LAST),
                _depth(depth) if comma else _depth(""),
            )
        except ValueError as error:
            raise BadToken(f"quality of service {text[:80]!r}: {error}") from error


def _depth(text: str) -> int:
    if not text:
        return DEFAULT_DEPTH
    if not (text.isascii() and text.isdigit()):
        raise ValueError(f"expected a depth, got {text[:20]!r}")
    return min(int(text[:20]), DEPTH_MAX)


RELIABLE = Qos()
"""As rclpy's default: the last 10."""
SENSOR_DATA = Qos(Reliability.BEST_EFFORT, depth=5)
"""`qos_profile_sensor_data`."""
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
"""The last message, also for those that come later: maps."""
TF = Qos(depth=100)
SERVICES = Qos()
"""`qos_profile_services_default`."""
