"""Types of ROS 2 messages and services: class, name, hash and codec of each.

`rosbags` brings the messages of ROS 2 Jazzy, their CDR codec and their type hashes. The parts of services are added
here, as dataclasses like its own. Arrays of numbers are numpy arrays of the field's own width.
"""

import struct
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, Generic, TypeVar

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from rosbags.typesys.stores import ros2_jazzy as jazzy

from robrain.protocol.ros2.errors import BadCdr

M = TypeVar("M")
Q = TypeVar("Q")
R = TypeVar("R")

PLAIN_CDR = (b"\0\0", b"\0\1")
"""Big-endian and little-endian, by the first two of the `HEADER_BYTES` (DDSI-RTPS 10.2.1.2)."""
HEADER_BYTES = 4
MESSAGE_BYTES = 16_777_216
"""Of one message that is read: a map of 4000 × 4000 cells."""
SEQUENCE_MAX = 16_777_216
"""Entries of one sequence that is decoded."""

BatteryState = jazzy.sensor_msgs__msg__BatteryState
LaserScan = jazzy.sensor_msgs__msg__LaserScan
Marker = jazzy.visualization_msgs__msg__Marker
MarkerArray = jazzy.visualization_msgs__msg__MarkerArray
OccupancyGrid = jazzy.nav_msgs__msg__OccupancyGrid
Path = jazzy.nav_msgs__msg__Path
Pose = jazzy.geometry_msgs__msg__Pose
PoseStamped = jazzy.geometry_msgs__msg__PoseStamped
String = jazzy.std_msgs__msg__String
TFMessage = jazzy.tf2_msgs__msg__TFMessage
TransformStamped = jazzy.geometry_msgs__msg__TransformStamped


@dataclass
class Nothing:
    """A request without fields, which IDL does not allow: one byte stands for it."""

    structure_needs_at_least_one_member: int = 0


@dataclass
class TriggerResponse:
    """Response of `std_srvs/srv/Trigger` and `std_srvs/srv/SetBool`."""

    success: bool
    message: str


@dataclass
class Switch:
    """Request of `std_srvs/srv/SetBool`."""

    data: bool


@dataclass
class TaskText:
    """Request of `robrain_msgs/srv/SubmitTask`: a task as JSON."""

    task: str


@dataclass
class SubmitTaskResponse:
    """Response of `robrain_msgs/srv/SubmitTask`: the accepted task as JSON, or why it is not accepted."""

    accepted: bool
    answer: str


SERVICES: dict[str, tuple[type, str, type, str]] = {
    "std_srvs/srv/Trigger": (
        Nothing, "uint8 structure_needs_at_least_one_member", TriggerResponse, "bool success\nstring message"
    ),
    "std_srvs/srv/SetBool": (Switch, "bool data", TriggerResponse, "bool success\nstring message"),
    "robrain_msgs/srv/SubmitTask": (TaskText, "string task", SubmitTaskResponse, "bool accepted\nstring answer"),
}  # fmt: skip
"""Class and fields of the request, and of the response, of each service."""
_EVENT_INFO = "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\nint64 sequence_number"


@cache
def typestore() -> Typestore:
    """All types that are known; built at the first call (70 ms, and a few ms for the codec of each type used)."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.max_sequence_length = SEQUENCE_MAX
    # ROS 2's `char` is a uint8; rosbags 0.11 hashes it as the character of IDL, and with it each service.
    store.fielddefs["service_msgs/msg/ServiceEventInfo"] = [], _fields(_EVENT_INFO)
    for service, (request, request_text, response, response_text) in SERVICES.items():
        for part, kind, text in (("Request", request, request_text), ("Response", response, response_text)):
            store.fielddefs[f"{service}_{part}"] = [], _fields(text)
            store.types[f"{service}_{part}"] = kind
        _add_service(store.fielddefs, service)
    return store


def _fields(text: str) -> list[tuple[str, FieldDesc]]:
    ((_, fields),) = get_types_from_msg(text, "robrain/msg/Part").values()
    return list(fields)


def _add_service(fielddefs: Typesdict, service: str) -> None:
    """Describe a service as rosidl does, for its hash: request, response, and the event that introspection sends."""
    request, response = f"{service}_Request", f"{service}_Response"
    fielddefs[f"{service}_Event"] = (
        [],
        [
            ("info", (Nodetype.NAME, "service_msgs/msg/ServiceEventInfo")),
            ("request", (Nodetype.SEQUENCE, ((Nodetype.NAME, request), 1))),
            ("response", (Nodetype.SEQUENCE, ((Nodetype.NAME, response), 1))),
        ],
    )
    parts = ("request", request), ("response", response), ("event", f"{service}_Event")
    fielddefs[service] = [], [(f"{part}_message", (Nodetype.NAME, name)) for part, name in parts]


@dataclass(frozen=True)
class MessageType(Generic[M]):
    """A type of messages."""

    name: str
    """Such as `nav_msgs/msg/Odometry`."""
    message: type[M]
    max_bytes: int = field(default=MESSAGE_BYTES, kw_only=True)

    @cached_property
    def type_hash(self) -> str:
        """Hash of its definition (REP 2016), such as `RIHS01_…`; nodes with another one do not receive each other."""
        return typestore().hash_rihs01(self.name)

    def encode(self, message: M) -> bytes:
        """A message as CDR, little-endian.

        Raises:
            BadCdr: a field has a value that its type cannot hold.

        """
        try:
            return bytes(typestore().serialize_cdr(message, self.name, little_endian=True))
        except Exception as error:  # rosbags' generated code raises whatever the wrong value brings about
            raise BadCdr(f"{self.name} cannot be encoded: {error}") from error

    def decode(self, payload: bytes) -> M:
        """The message in CDR of either byte order. Arrays are views of `payload`, and read-only.

        Bytes behind the message are passed over, as Fast CDR does: `rclpy.serialization` leaves some.

        Raises:
            BadCdr: it is too large, is another encoding, ends early, or holds a text that is not UTF-8.

        """
        if len(payload) > self.max_bytes:
            raise BadCdr(f"{self.name} of {len(payload)} bytes: expected at most {self.max_bytes}")
        if payload[:2] not in PLAIN_CDR or len(payload) < HEADER_BYTES:
            raise BadCdr(f"{self.name} of {len(payload)} bytes: expected plain CDR, got {payload[:2].hex()}")
        store = typestore()
        codec = store.get_msgdef(self.name)
        read = codec.deserialize_cdr_le if payload[1] else codec.deserialize_cdr_be
        try:
            message, _ = read(memoryview(payload)[HEADER_BYTES:], 0, codec.cls, store)
        except (SerdeError, struct.error, ValueError, IndexError, OverflowError) as error:
            raise BadCdr(f"{self.name} of {len(payload)} bytes: {error}") from error
        if not isinstance(message, self.message):
            raise TypeError(f"{self.name} is not {self.message}")
        return message

    def blank(self, **values: Any) -> M:
        """A message of zeros and empty texts, but for `values`; quaternions are all zero too."""
        fields = typestore().fielddefs[self.name][1]
        return self.message(**{name: _blank(desc) for name, desc in fields} | values)


def _blank(desc: FieldDesc) -> Any:
    """Zero of a field's type."""
    if desc[0] == Nodetype.BASE:
        return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(desc[1][0], 0)
    if desc[0] == Nodetype.NAME:
        store = typestore()
        return store.types[desc[1]](**{name: _blank(inner) for name, inner in store.fielddefs[desc[1]][1]})
    inner, length = desc[1]
    count = length if desc[0] == Nodetype.ARRAY else 0
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        return np.zeros(count, {"bool": "bool", "byte": "uint8", "char": "uint8"}.get(inner[1][0], inner[1][0]))
    return [_blank(inner) for _ in range(count)]


@dataclass(frozen=True)
class ServiceType(Generic[Q, R]):
    """A type of services."""

    name: str
    """Such as `std_srvs/srv/Trigger`."""
    request: MessageType[Q]
    response: MessageType[R]

    @cached_property
    def type_hash(self) -> str:
        """Hash of its definition."""
        return typestore().hash_rihs01(self.name)


def _service(name: str, request: type[Q], response: type[R]) -> ServiceType[Q, R]:
    return ServiceType(name, MessageType(f"{name}_Request", request), MessageType(f"{name}_Response", response))


def _message(message: type[M]) -> MessageType[M]:
    return MessageType(message.__msgtype__, message)  # type: ignore[attr-defined]


STRING = _message(String)
POSE_STAMPED = _message(PoseStamped)
TRANSFORM_STAMPED = _message(TransformStamped)
OCCUPANCY_GRID = _message(OccupancyGrid)
PATH = _message(Path)
LASER_SCAN = _message(LaserScan)
BATTERY_STATE = _message(BatteryState)
TF_MESSAGE = _message(TFMessage)
MARKER = _message(Marker)
MARKER_ARRAY = _message(MarkerArray)

TRIGGER = _service("std_srvs/srv/Trigger", Nothing, TriggerResponse)
SET_BOOL = _service("std_srvs/srv/SetBool", Switch, TriggerResponse)
SUBMIT_TASK = _service("robrain_msgs/srv/SubmitTask", TaskText, SubmitTaskResponse)
