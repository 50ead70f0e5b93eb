"""Liveliness tokens of `rmw_zenoh`: nodes find other nodes, topics and services by them.

`@ros2_lv/DOMAIN/SESSION/NODE/ENTITY/KIND/ENCLAVE/NAMESPACE/NAME`, and for all but nodes `/TOPIC/TYPE/HASH/QOS`
(rmw_zenoh: design.md, liveliness_utils.cpp). Later releases append parts, which are read over.
"""

from enum import StrEnum

import msgspec
import xxhash

from robrain.protocol.ros2.errors import BadRosName, BadToken
from robrain.protocol.ros2.qos import Qos
from robrain.protocol.ros2.ros_names import (
    DOMAIN_MAX,
    check_domain,
    check_namespace,
    check_node_name,
    data_key,
    dds_type,
    demangled,
    full_name,
    mangled,
    ros_type,
)

SPACE = "@ros2_lv"
TOKEN_MAX = 2048
"""Characters of a token that is read."""
NODE_PARTS = 9
ENDPOINT_PARTS = 13
TYPE_HASH_MAX = 80


class EntityKind(StrEnum):
    """Subject of a token."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVER = "SS"
    CLIENT = "SC"


class NodeId(msgspec.Struct, frozen=True):
    """A node."""

    domain: int
    session: str
    """Id of its Zenoh session."""
    number: int
    """Unique in its session."""
    namespace: str
    name: str

    @property
    def full_name(self) -> str:
        """Name with its namespace, as `ros2 node list` prints it."""
        return f"{self.namespace.rstrip('/')}/{self.name}"


class Entity(msgspec.Struct, frozen=True):
    """A node (without the last four), or something that it has."""

    kind: EntityKind
    node: NodeId
    number: int
    """Unique in its session; a node's own number for a node."""
    name: str = ""
    """Of the topic or service."""
    type_name: str = ""
    type_hash: str = ""
    """Older releases write words here where a type has no hash."""
    qos: Qos = Qos()

    @property
    def token(self) -> str:
        """Key of its token."""
        node = self.node
        parts = [SPACE, str(check_domain(node.domain)), node.session, str(node.number), str(self.number), self.kind]
        parts += ["%", mangled(node.namespace), node.name]
        if self.kind is not EntityKind.NODE:
            parts += [mangled(self.name), dds_type(self.type_name), self.type_hash, self.qos.token]
        return "/".join(parts)

    @property
    def key(self) -> str:
        """Key of its messages or requests."""
        return data_key(self.node.domain, self.name, self.type_name, self.type_hash)

    @property
    def gid(self) -> bytes:
        """Its id in attachments: XXH3 of the token, as rmw_zenoh derives it."""
        return xxhash.xxh3_128_intdigest(self.token.encode()).to_bytes(16, "little")

    @classmethod
    def parse(cls, token: str) -> "Entity":
        """Read a token.

        Raises:
            BadToken: it is none.

        """
        if len(token) > TOKEN_MAX:
            raise BadToken(f"token of {len(token)} characters: expected at most {TOKEN_MAX}")
        parts = token.split("/")
        if len(parts) < NODE_PARTS or parts[0] != SPACE or not all(parts):
            raise BadToken(f"{token[:120]!r}: expected {SPACE}/ and {NODE_PARTS - 1} parts or more")
        try:
            kind = EntityKind(parts[5])
            namespace = check_namespace(demangled(parts[7]))
            domain, number = _number(parts[1], DOMAIN_MAX), _number(parts[3])
            node = NodeId(domain, parts[2], number, namespace, check_node_name(parts[8]))
            if kind is EntityKind.NODE:
                return cls(kind, node, _number(parts[4]))
            if len(parts) < ENDPOINT_PARTS:
                raise BadToken(f"{token[:120]!r}: expected {ENDPOINT_PARTS} parts of a {kind.name.lower()}")
            if len(parts[11]) > TYPE_HASH_MAX:
                raise BadToken(f"{token[:120]!r}: a type hash of {len(parts[11])} characters")
            name, type_name = full_name(demangled(parts[9])), ros_type(parts[10])
            return cls(kind, node, _number(parts[4]), name, type_name, parts[11], Qos.from_token(parts[12]))
        except (ValueError, BadRosName) as error:
            raise BadToken(f"{token[:120]!r}: {error}") from error


def domain_tokens(domain: int) -> str:
    """Selector of all tokens of a domain."""
    return f"{SPACE}/{check_domain(domain)}/**"


def _number(text: str, largest: int = 2**63) -> int:
    if not (text.isascii() and text.isdigit()) or len(text) > 20 or int(text) > largest:
        raise ValueError(f"expected a number up to {largest}, got {text[:30]!r}")
    return int(text)
