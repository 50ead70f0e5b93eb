"""Parameters that all plugins for ROS 2 robots have."""

import os
import re

import msgspec

from robrain.protocol.model.ranges import check_within

DOMAIN_MAX = 232
"""Above it the ports that DDS derives from the domain do not exist."""
DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
_NAMESPACE = re.compile(r"(/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*)?")
_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


class Ros2Parameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the robot's topics are."""

    namespace: str = ""
    """Namespace of the robot's topics, such as `/r7`; topics that begin with `/` are not in it."""
    domain_id: int | None = None
    """ROS domain; absent: `$ROS_DOMAIN_ID`, else 0."""

    def __post_init__(self) -> None:
        if not _NAMESPACE.fullmatch(self.namespace):
            raise ValueError(f"expected namespace as in /r7, got {self.namespace!r}")
        check_within(self, 0, DOMAIN_MAX, "domain_id")

    def topic(self, name: str) -> str:
        """The full name of a topic.

        >>> Ros2Parameters(namespace="r7").topic("odom")
        '/r7/odom'
        """
        if name.startswith("/"):
            return name
        namespace = self.namespace.strip("/")
        return f"/{namespace}/{name}" if namespace else f"/{name}"


def check_topics(parameters: msgspec.Struct, *names: str) -> None:
    """Check that parameters are names of topics (ValueError)."""
    for name in names:
        topic = getattr(parameters, name)
        if not _TOPIC.fullmatch(topic):
            raise ValueError(f"expected {name} to be a topic such as odom or /odom, got {topic!r}")


def environment_domain() -> int:
    """The ROS domain that the environment names; 0 if it names none (ValueError)."""
    text = os.environ.get(DOMAIN_VARIABLE, "") or "0"
    if not text.isdigit() or int(text) > DOMAIN_MAX:
        raise ValueError(f"expected ${DOMAIN_VARIABLE} from 0 to {DOMAIN_MAX}, got {text!r}")
    return int(text)
