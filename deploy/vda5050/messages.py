"""Messages of VDA 5050 in the versions 2.1.0 and 3.0.0, as structs with ranges.

Messages that robrain writes have the names of version 3; `versions.toml` renames their fields for version 2. Of the
messages that it reads, a field that only one version has is absent in messages of the other version.
The fields are those of https://github.com/VDA5050/VDA5050 that robrain reads or writes; others are ignored.
"""

import datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
from msgspec import UNSET, Meta, UnsetType

from robrain.protocol.clock import to_seconds
from robrain.protocol.errors import RobrainError
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.geometry import Point2D, Pose2D, wrap_angle_rad
from robrain.protocol.model.ranges import Metres, Name, Quantity, Radians, Speed, Text

NODES_MAX = 1000
"""Nodes of an order, and of one with its updates."""
Number = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Percent = Annotated[float, Meta(ge=0.0, le=100.0)]
ErrorLevel = Literal["WARNING", "URGENT", "CRITICAL", "FATAL"]


class BadVehicleMessage(RobrainError):
    """A message of MQTT that cannot be read; the text names topic and key."""


class Version(StrEnum):
    """A version of VDA 5050."""

    V2_1 = "2.1.0"
    V3_0 = "3.0.0"


class Differences(msgspec.Struct):
    """The words of one version for those of version 3: a table of `versions.toml`."""

    topic: str
    """The first levels of its topics."""
    connection_broken: str
    type_specification: dict[str, Any]
    """Fields of the factsheet."""
    errors: dict[str, str]
    """Types of errors; empty where the version has no such error."""
    levels: dict[str, ErrorLevel]
    names: dict[str, str] = {}
    """Names of fields; empty where the version has no such field."""


_TABLES = Path(__file__).with_name("versions.toml").read_bytes()
DIFFERENCES = msgspec.toml.decode(_TABLES, type=dict[Version, Differences])


class VdaStruct(msgspec.Struct, rename="camel"):
    """A message without its header, or a part of one."""


class Waypoint(VdaStruct):
    """A point in the map's frame, metres."""

    x: Metres
    y: Metres


class Vehicle(NamedTuple):
    """Address of a vehicle on MQTT, and its map."""

    version: Version
    manufacturer: str
    serial: str
    map_id: str
    T_arena_map: Pose2D

    @property
    def words(self) -> Differences:
        """The words of its version."""
        return DIFFERENCES[self.version]

    def to_arena(self, x_m: float, y_m: float, yaw_rad: float = 0.0) -> Pose2D:
        """A pose of the map in the arena frame."""
        return self.T_arena_map.compose(Pose2D(x_m, y_m, wrap_angle_rad(yaw_rad)))

    def from_arena(self, x_m: float, y_m: float, yaw_rad: float = 0.0) -> Pose2D:
        """A pose of the arena frame in the map's."""
        return self.T_arena_map.inverse().compose(Pose2D(x_m, y_m, yaw_rad))

    def waypoint(self, x_m: float, y_m: float) -> Waypoint:
        """A point of the arena frame in the map's."""
        at = self.from_arena(x_m, y_m)
        return Waypoint(at.x_m, at.y_m)

    def place(self, at: Waypoint) -> Point2D:
        """A point of the map in the arena frame."""
        pose = self.to_arena(at.x, at.y)
        return Point2D(pose.x_m, pose.y_m)

    def topic(self, name: str) -> str:
        """A topic of the vehicle, such as `uagv/v2/acme/7/order`."""
        return f"{self.words.topic}/{self.manufacturer}/{self.serial}/{name}"

    def payload(self, body: Any, header_id: int, now_ns: int) -> bytes:
        """A message with the protocol header; its body is a struct or a mapping, with the names of version 3."""
        header = {
            "headerId": header_id % 2**32,
            "timestamp": timestamp(now_ns),
            "version": self.version,
            "manufacturer": self.manufacturer,
            "serialNumber": self.serial,
        }
        return msgspec.json.encode({**header, **_renamed(msgspec.to_builtins(body), self.words.names)})


def _renamed(content: Any, names: dict[str, str]) -> Any:
    match content:
        case dict():
            return {name: _renamed(one, names) for key, one in content.items() if (name := names.get(key, key))}
        case list():
            return [_renamed(one, names) for one in content]
    return content


def timestamp(now_ns: int) -> str:
    """A stamp of the live clock in the form of the standard."""
    stamp = datetime.datetime.fromtimestamp(to_seconds(now_ns), datetime.UTC)
    return stamp.isoformat(timespec="milliseconds").replace("+00:00", "Z")


ActionStatus = Literal["WAITING", "INITIALIZING", "RUNNING", "PAUSED", "RETRIABLE", "FINISHED", "FAILED"]
ENDED: tuple[ActionStatus, ...] = ("FINISHED", "FAILED")
"""The states of an action that nothing follows."""


class ActionParameter(VdaStruct):
    """Parameter of an action."""

    key: Name
    value: Any


class OrderAction(VdaStruct):
    """An action of a node or an edge, or an instant action."""

    action_type: Name
    action_id: Name
    blocking_type: Literal["NONE", "SOFT", "SINGLE", "HARD"]
    """Whether it allows driving and other actions."""
    action_parameters: Annotated[list[ActionParameter], Meta(max_length=64)] | UnsetType = UNSET

    def parameter(self, key: str) -> Any:
        """Value of a parameter; None without one."""
        return next((one.value for one in self.action_parameters or () if one.key == key), None)


Actions = Annotated[list[OrderAction], Meta(max_length=64)]


Deviation = Metres | Annotated[dict[str, Metres], Meta(max_length=8)]
"""Allowed distance from a node, metres; in version 3 an ellipse with half axes `a` and `b`."""


class NodePosition(Waypoint):
    """Place of a node; its heading in radians."""

    map_id: Name
    theta: Radians | UnsetType = UNSET
    allowed_deviation: Deviation | UnsetType = msgspec.field(default=UNSET, name="allowedDeviationXY")

    @property
    def deviation_m(self) -> float:
        """Allowed distance from the node; 0 if none is given."""
        allowed = self.allowed_deviation
        return min(allowed.get("a", 0.0), allowed.get("b", 0.0)) if isinstance(allowed, dict) else allowed or 0.0


class OrderPart(VdaStruct):
    """The fields that nodes and edges share."""

    sequence_id: Number
    released: bool
    actions: Actions


class OrderNode(OrderPart):
    """A node of an order."""

    node_id: Name
    node_position: NodePosition | UnsetType = UNSET


class OrderEdge(OrderPart):
    """An edge of an order."""

    edge_id: Name
    start_node_id: Name
    end_node_id: Name


class VehicleOrder(VdaStruct):
    """An order, or an update of one."""

    order_id: Name
    order_update_id: Number
    nodes: Annotated[list[OrderNode], Meta(min_length=1, max_length=NODES_MAX)]
    edges: Annotated[list[OrderEdge], Meta(max_length=NODES_MAX)]


class InstantActions(VdaStruct):
    """Actions for now."""

    actions: Actions


OperatingMode = Literal[
    "STARTUP", "AUTOMATIC", "SEMIAUTOMATIC", "INTERVENED", "MANUAL", "SERVICE", "TEACHIN", "TEACH_IN"
]
"""Control over a vehicle: by its master, or by a person."""


class Reference(VdaStruct):
    """The cause of an error."""

    reference_key: Name
    reference_value: Text


class VehicleError(VdaStruct):
    """An error that a vehicle reports."""

    error_type: Name
    error_level: ErrorLevel
    error_description: Text | UnsetType = UNSET
    error_references: Annotated[list[Reference], Meta(max_length=64)] | UnsetType = UNSET

    @property
    def words(self) -> str:
        """The error in one line."""
        return f"{self.error_type}: {self.error_description}" if self.error_description else self.error_type


class ActionState(VdaStruct):
    """State of an action."""

    action_id: Name
    action_status: ActionStatus
    action_type: Name | UnsetType = UNSET


class NodeState(VdaStruct):
    """A node that the vehicle has yet to reach."""

    sequence_id: Number


class Position(Waypoint):
    """Position of a vehicle; its heading in radians."""

    theta: Radians
    map_id: Name
    position_initialized: bool | UnsetType = UNSET
    localized: bool | UnsetType = UNSET


class Velocity(VdaStruct):
    """Velocity of a vehicle, in its frame."""

    vx: Speed = 0.0
    vy: Speed = 0.0
    omega: Speed = 0.0


class VehiclePower(VdaStruct):
    """Battery of a vehicle: `stateOfCharge` is `batteryCharge` in version 2."""

    charging: bool
    battery_charge: Percent | UnsetType = UNSET
    state_of_charge: Percent | UnsetType = UNSET
    battery_voltage: Quantity | UnsetType = UNSET
    battery_current: Quantity | UnsetType = UNSET


class Polyline(VdaStruct):
    """The path that a vehicle follows next."""

    polyline: Annotated[list[Waypoint], Meta(max_length=10_000)]


class ZoneSetState(VdaStruct):
    """A zone set on a vehicle."""

    zone_set_id: Name
    zone_set_status: Name


class State(VdaStruct):
    """State of a vehicle."""

    order_id: Name
    last_node_id: Name
    node_states: Annotated[list[NodeState], Meta(max_length=NODES_MAX)]
    edge_states: Annotated[list[dict[str, Any]], Meta(max_length=NODES_MAX)]
    driving: bool
    operating_mode: OperatingMode
    action_states: Annotated[list[ActionState], Meta(max_length=10_000)]
    errors: Annotated[list[VehicleError], Meta(max_length=256)]
    paused: bool | UnsetType = UNSET
    velocity: Velocity | UnsetType = UNSET
    agv_position: Position | UnsetType = UNSET
    mobile_robot_position: Position | UnsetType = UNSET
    battery_state: VehiclePower | UnsetType = UNSET
    power_supply: VehiclePower | UnsetType = UNSET
    intermediate_path: Polyline | UnsetType = UNSET
    zone_sets: Annotated[list[ZoneSetState], Meta(max_length=64)] | UnsetType = UNSET

    @property
    def position(self) -> Position | None:
        """Where the vehicle is; None if it does not know."""
        found = self.mobile_robot_position or self.agv_position
        return found if found and (found.localized or found.position_initialized) else None

    @property
    def battery(self) -> BatteryState | None:
        """Its battery; None if it reports none."""
        power = self.power_supply or self.battery_state
        return None if not power else BatteryState(
            voltage_v=power.battery_voltage or 0.0, current_a=-(power.battery_current or 0.0), temperature_c=0.0,
            soc=(power.state_of_charge or power.battery_charge or 0.0) / 100.0, remaining_j=0.0,
            charging=power.charging)  # fmt: skip

    @property
    def is_idle(self) -> bool:
        """Whether it does no order, also none whose actions still run."""
        has_actions = any(one.action_status not in ENDED for one in self.action_states)
        return not (self.node_states or self.edge_states or has_actions)


class VehicleConnection(VdaStruct):
    """A vehicle's connection to the broker."""

    connection_state: Literal["ONLINE", "OFFLINE", "HIBERNATING", "CONNECTIONBROKEN", "CONNECTION_BROKEN"]


TOPICS: dict[str, type[VdaStruct]] = {
    "order": VehicleOrder,
    "instantActions": InstantActions,
    "state": State,
    "connection": VehicleConnection,
}
"""Messages that robrain reads, by the last level of their topics."""


def read(topic: str, payload: bytes) -> VdaStruct:
    """Decode and check a message (BadVehicleMessage)."""
    try:
        return msgspec.json.decode(payload.decode(), type=TOPICS[topic.rpartition("/")[2]])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadVehicleMessage(f"{topic}: {error}") from error
