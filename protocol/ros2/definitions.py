"""Definitions of message types, for the CDR codec and the type hashes of `rosbags`.

`rosbags` brings the messages of ROS 2 Jazzy. The parts of services and actions are added here, as dataclasses like its
own; `typestore` knows all of them.
"""

from dataclasses import dataclass
from functools import cache

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from robrain.protocol.ros2.message_classes import UUID, Duration, GoalInfo, PoseStamped, Time

SEQUENCE_MAX = 16_777_216
"""Entries of one sequence that is decoded."""


@dataclass
class Nothing:
    """A request or goal without fields, which IDL does not allow: one byte stands for it."""

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


@dataclass
class CancelRequest:
    """Request of `action_msgs/srv/CancelGoal`."""

    goal_info: GoalInfo


@dataclass
class CancelResponse:
    """Response of `action_msgs/srv/CancelGoal`; `return_code` is 0 if all named goals are being cancelled."""

    return_code: int
    goals_canceling: list[GoalInfo]


@dataclass
class GoalAccepted:
    """Response of each action's `SendGoal`."""

    accepted: bool
    stamp: Time


@dataclass
class ResultRequest:
    """Request of each action's `GetResult`."""

    goal_id: UUID


@dataclass
class NavigateGoal:
    """Goal of `nav2_msgs/action/NavigateToPose`; `behavior_tree` is empty for the navigator's own."""

    pose: PoseStamped
    behavior_tree: str


@dataclass
class NavigateResult:
    """Result of `nav2_msgs/action/NavigateToPose` since Jazzy; `error_code` is 0 if it went well."""

    error_code: int
    error_msg: str


@dataclass
class NavigateFeedback:
    """Feedback of `nav2_msgs/action/NavigateToPose`, up to Kilted."""

    current_pose: PoseStamped
    navigation_time: Duration
    estimated_time_remaining: Duration
    number_of_recoveries: int
    distance_remaining: float


@dataclass
class NavigateSendGoal:
    """Request of NavigateToPose's `SendGoal`."""

    goal_id: UUID
    goal: NavigateGoal


@dataclass
class NavigateResultResponse:
    """Response of NavigateToPose's `GetResult`; `status` is one of `action_msgs/msg/GoalStatus`."""

    status: int
    result: NavigateResult


@dataclass
class NavigateFeedbackMessage:
    """Feedback of NavigateToPose while it drives."""

    goal_id: UUID
    feedback: NavigateFeedback


TRIGGER, SET_BOOL, CANCEL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool", "action_msgs/srv/CancelGoal"
SUBMIT_TASK = "robrain_msgs/srv/SubmitTask"
NAVIGATE = "nav2_msgs/action/NavigateToPose"
SERVICES = (TRIGGER, SET_BOOL, SUBMIT_TASK, CANCEL, f"{NAVIGATE}_SendGoal", f"{NAVIGATE}_GetResult")

_EVENT_INFO = "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\nint64 sequence_number"
_NOTHING = "uint8 structure_needs_at_least_one_member"
_PARTS: dict[str, tuple[type, str]] = {
    f"{TRIGGER}_Request": (Nothing, _NOTHING),
    f"{TRIGGER}_Response": (TriggerResponse, "bool success\nstring message"),
    f"{SET_BOOL}_Request": (Switch, "bool data"),
    f"{SET_BOOL}_Response": (TriggerResponse, "bool success\nstring message"),
    f"{SUBMIT_TASK}_Request": (TaskText, "string task"),
    f"{SUBMIT_TASK}_Response": (SubmitTaskResponse, "bool accepted\nstring answer"),
    f"{CANCEL}_Request": (CancelRequest, "action_msgs/GoalInfo goal_info"),
    f"{CANCEL}_Response": (CancelResponse, "int8 return_code\naction_msgs/GoalInfo[] goals_canceling"),
    f"{NAVIGATE}_Goal": (NavigateGoal, "geometry_msgs/PoseStamped pose\nstring behavior_tree"),
    f"{NAVIGATE}_Result": (NavigateResult, "uint16 error_code\nstring error_msg"),
    f"{NAVIGATE}_Feedback": (
        NavigateFeedback,
        """geometry_msgs/PoseStamped current_pose
        builtin_interfaces/Duration navigation_time
        builtin_interfaces/Duration estimated_time_remaining
        int16 number_of_recoveries
        float32 distance_remaining""",
    ),
    f"{NAVIGATE}_SendGoal_Request": (
        NavigateSendGoal,
        f"unique_identifier_msgs/UUID goal_id\n{NAVIGATE.replace('/action', '')}_Goal goal",
    ),
    f"{NAVIGATE}_SendGoal_Response": (GoalAccepted, "bool accepted\nbuiltin_interfaces/Time stamp"),
    f"{NAVIGATE}_GetResult_Request": (ResultRequest, "unique_identifier_msgs/UUID goal_id"),
    f"{NAVIGATE}_GetResult_Response": (
        NavigateResultResponse,
        f"int8 status\n{NAVIGATE.replace('/action', '')}_Result result",
    ),
    f"{NAVIGATE}_FeedbackMessage": (
        NavigateFeedbackMessage,
        f"unique_identifier_msgs/UUID goal_id\n{NAVIGATE.replace('/action', '')}_Feedback feedback",
    ),
}
"""Class and fields of each part of a service or action, by its name."""


@cache
def typestore() -> Typestore:
    """All types that are known; built at the first call (70 ms, and a few ms for the codec of each type used)."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.max_sequence_length = SEQUENCE_MAX
    # ROS 2's `char` is a uint8; rosbags 0.11 hashes it as the character of IDL, and with it each service.
    store.fielddefs["service_msgs/msg/ServiceEventInfo"] = [], _fields(_EVENT_INFO)
    for name, (message, text) in _PARTS.items():
        store.fielddefs[name] = [], [(field, _own_name(desc)) for field, desc in _fields(text)]
        store.types[name] = message
    for service in SERVICES:
        _add_service(store.fielddefs, service)
    return store


@cache
def type_hash(type_name: str) -> str:
    """Hash of a message or service type (REP 2016), such as `RIHS01_…`.

    Raises:
        KeyError: the type is not known.

    """
    return typestore().hash_rihs01(type_name)


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


def _own_name(desc: FieldDesc) -> FieldDesc:
    """A field whose type is a part of an action: its name has `action` where the text has `msg`."""
    if desc[0] == Nodetype.NAME and desc[1].startswith("nav2_msgs/msg/"):
        return Nodetype.NAME, desc[1].replace("/msg/", "/action/")
    return desc
