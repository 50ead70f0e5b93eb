"""Errors of the ROS 2 side.

RobrainError
└── RosError                  something that ROS 2 nodes do not understand
    ├── BadRosName            a name of a node, topic, service or type against the rules of ROS 2
    ├── BadCdr                bytes that are not the message they claim to be; or a message that cannot be encoded
    └── BadAttachment         bytes that are no attachment of rmw_zenoh
"""

from robrain.protocol.errors import RobrainError


class RosError(RobrainError):
    """Something that ROS 2 nodes do not understand."""


class BadRosName(RosError):
    """A name of a node, topic, service or type against the rules of ROS 2."""

    def __init__(self, what: str, name: str, why: str) -> None:
        super().__init__(f"bad ROS 2 {what} {name[:80]!r}: {why}")
        self.name = name


class BadCdr(RosError):
    """Bytes that are not the message they claim to be, or a message that cannot be encoded."""


class BadAttachment(RosError):
    """Bytes that are no attachment of rmw_zenoh."""
