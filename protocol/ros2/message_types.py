"""Types of ROS 2 messages, services and actions: class, name, hash and codec of each.

Messages are dataclasses of `rosbags`; arrays of numbers are numpy arrays of the field's own width.
"""

import struct
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.serde import SerdeError

from robrain.protocol.ros2 import definitions
from robrain.protocol.ros2.errors import BadCdr
from robrain.protocol.ros2.message_classes import (
    BatteryState,
    Bool,
    GoalStatusArray,
    Header,
    Imu,
    LaserScan,
    MapMetaData,
    Marker,
    MarkerArray,
    OccupancyGrid,
    Odometry,
    Path,
    PointCloud2,
    Pose,
    PoseStamped,
    PoseWithCovarianceStamped,
    String,
    TFMessage,
    TransformStamped,
    Twist,
    TwistStamped,
)

M = TypeVar("M")
Q = TypeVar("Q")
R = TypeVar("R")

PLAIN_CDR = (b"\0\0", b"\0\1")
"""Big-endian and little-endian, by the first two of the `HEADER_BYTES` (DDSI-RTPS 10.2.1.2)."""
HEADER_BYTES = 4
MESSAGE_BYTES = 16_777_216
"""Of one message that is read: a map of 4000 × 4000 cells."""


@dataclass(frozen=True)
class MessageType(Generic[M]):
    """A type of messages."""

    name: str
    """Such as `nav_msgs/msg/Odometry`."""
    message: type[M]
    max_bytes: int = field(default=MESSAGE_BYTES, kw_only=True)

    @cached_property
    def type_hash(self) -> str:
        """Hash of its definition, such as `RIHS01_…`; nodes with another one do not receive each other."""
        return definitions.type_hash(self.name)

    def encode(self, message: M) -> bytes:
        """A message as CDR, little-endian.

        Raises:
            BadCdr: a field has a value that its type cannot hold.

        """
        try:
            return bytes(definitions.typestore().serialize_cdr(message, self.name, little_endian=True))
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
        store = definitions.typestore()
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
        fields = definitions.typestore().fielddefs[self.name][1]
        return self.message(**{name: _blank(desc) for name, desc in fields} | values)


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
        return definitions.type_hash(self.name)


def _service(name: str, request: type[Q], response: type[R]) -> ServiceType[Q, R]:
    return ServiceType(name, MessageType(f"{name}_Request", request), MessageType(f"{name}_Response", response))


def _message(message: type[M]) -> MessageType[M]:
    return MessageType(message.__msgtype__, message)  # type: ignore[attr-defined]


def _blank(desc: FieldDesc) -> Any:
    """Zero of a field's type."""
    if desc[0] == Nodetype.BASE:
        return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(desc[1][0], 0)
    if desc[0] == Nodetype.NAME:
        store = definitions.typestore()
        return store.types[desc[1]](**{name: _blank(inner) for name, inner in store.fielddefs[desc[1]][1]})
    inner, length = desc[1]
    count = length if desc[0] == Nodetype.ARRAY else 0
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        return np.zeros(count, {"bool": "bool", "byte": "uint8", "char": "uint8"}.get(inner[1][0], inner[1][0]))
    return [_blank(inner) for _ in range(count)]


STRING = _message(String)
BOOL = _message(Bool)
TWIST = _message(Twist)
TWIST_STAMPED = _message(TwistStamped)
POSE = _message(Pose)
POSE_STAMPED = _message(PoseStamped)
POSE_WITH_COVARIANCE_STAMPED = _message(PoseWithCovarianceStamped)
TRANSFORM_STAMPED = _message(TransformStamped)
HEADER = _message(Header)
ODOMETRY = _message(Odometry)
OCCUPANCY_GRID = _message(OccupancyGrid)
MAP_META_DATA = _message(MapMetaData)
PATH = _message(Path)
LASER_SCAN = _message(LaserScan)
BATTERY_STATE = _message(BatteryState)
IMU = _message(Imu)
POINT_CLOUD = _message(PointCloud2)
TF_MESSAGE = _message(TFMessage)
MARKER = _message(Marker)
MARKER_ARRAY = _message(MarkerArray)
GOAL_STATUSES = _message(GoalStatusArray)

TRIGGER = _service(definitions.TRIGGER, definitions.Nothing, definitions.TriggerResponse)
SET_BOOL = _service(definitions.SET_BOOL, definitions.Switch, definitions.TriggerResponse)
SUBMIT_TASK = _service(definitions.SUBMIT_TASK, definitions.TaskText, definitions.SubmitTaskResponse)
CANCEL_GOAL = _service(definitions.CANCEL, definitions.CancelRequest, definitions.CancelResponse)
NAVIGATE_SEND_GOAL = _service(
    f"{definitions.NAVIGATE}_SendGoal", definitions.NavigateSendGoal, definitions.GoalAccepted
)
NAVIGATE_GET_RESULT = _service(
    f"{definitions.NAVIGATE}_GetResult", definitions.ResultRequest, definitions.NavigateResultResponse
)
NAVIGATE_FEEDBACK = MessageType(f"{definitions.NAVIGATE}_FeedbackMessage", definitions.NavigateFeedbackMessage)
