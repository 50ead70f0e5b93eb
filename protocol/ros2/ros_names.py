"""Names of ROS 2, and how `rmw_zenoh` writes them into keys.

Rules of names: https://design.ros2.org/articles/topic_and_service_names.html. In tokens, `/` is written as `%`; a type
`nav_msgs/msg/Odometry` is `nav_msgs::msg::dds_::Odometry_` in every key.
"""

import os
import re

from robrain.protocol.ros2.errors import BadRosName

NAME_MAX = 247
"""Characters of a fully qualified name (rmw/validate_full_topic_name.h)."""
DOMAIN_MAX = 232
"""Largest domain id that DDS has ports for; rmw_zenoh itself takes any."""
DOMAIN_VARIABLE = "ROS_DOMAIN_ID"

_PART = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_TYPE = re.compile(r"([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Z][A-Za-z0-9_]*)")


def environment_domain() -> int:
    """The ROS domain that the environment names; 0 if it names none (ValueError)."""
    text = os.environ.get(DOMAIN_VARIABLE, "") or "0"
    if not text.isdigit() or int(text) > DOMAIN_MAX:
        raise ValueError(f"expected ${DOMAIN_VARIABLE} from 0 to {DOMAIN_MAX}, got {text!r}")
    return int(text)


def check_node_name(name: str) -> str:
    """Return a node's name.

    Raises:
        BadRosName: it is not one word of letters, digits and underscores.

    """
    if len(name) > NAME_MAX or not _PART.fullmatch(name):
        raise BadRosName("node name", name, "expected letters, digits and underscores, not first a digit")
    return name


def check_domain(domain: int) -> int:
    """Return a domain id.

    Raises:
        BadRosName: it is negative or above `DOMAIN_MAX`.

    """
    if not 0 <= domain <= DOMAIN_MAX:
        raise BadRosName("domain", str(domain), f"expected 0 to {DOMAIN_MAX}")
    return domain


def full_name(name: str, namespace: str = "/", node: str = "") -> str:
    """Name of a topic or service with its namespace.

    Args:
        name: `/absolute`, `relative` to the namespace, or `~/private` to the node.
        namespace: of the node, such as `/` or `/robots/r1`.
        node: name of the node.

    Raises:
        BadRosName: the result is no name of ROS 2.

    >>> full_name("scan", "/r1"), full_name("/tf", "/r1"), full_name("~/state", "/r1", "driver")
    ('/r1/scan', '/tf', '/r1/driver/state')
    """
    base = namespace.rstrip("/")
    if name == "~" or name.startswith("~/"):
        found = f"{base}/{check_node_name(node)}{name[1:]}"
    elif name.startswith("/"):
        found = name
    else:
        found = f"{base}/{name}"
    if len(found) > NAME_MAX:
        raise BadRosName("name", found, f"longer than {NAME_MAX} characters")
    parts = found[1:].split("/")
    if not found.startswith("/") or not all(map(_PART.fullmatch, parts)):
        raise BadRosName("name", found, "expected words of letters, digits and underscores between slashes")
    return found


def check_namespace(namespace: str) -> str:
    """Return a namespace: `/`, or a full name.

    Raises:
        BadRosName: it is neither.

    """
    return namespace if namespace == "/" else full_name("/" + namespace.strip("/"))


def dds_type(type_name: str) -> str:
    """Name of a type as it stands in keys.

    Raises:
        BadRosName: it is no name of a type.

    >>> dds_type("std_srvs/srv/Trigger")
    'std_srvs::srv::dds_::Trigger_'
    """
    match = _TYPE.fullmatch(type_name)
    if match is None or len(type_name) > NAME_MAX:
        raise BadRosName("type", type_name, "expected something like nav_msgs/msg/Odometry")
    package, kind, name = match.groups()
    return f"{package}::{kind}::dds_::{name}_"


def data_key(domain: int, name: str, type_name: str, type_hash: str) -> str:
    """Key on which a topic's messages are put, and a service's requests are asked.

    >>> data_key(0, "/r1/scan", "sensor_msgs/msg/LaserScan", "RIHS01_" + 64 * "0")[:50]
    '0/r1/scan/sensor_msgs::msg::dds_::LaserScan_/RIHS0'
    """
    return f"{check_domain(domain)}/{name.strip('/')}/{dds_type(type_name)}/{type_hash}"
