"""Messages between a robot's process and that of an isolated plugin. MessagePack, never pickle."""

from typing import Any

import msgspec

from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.geometry import Pose2D

OWN = 0
"""The handle that stands for the isolated plugin itself."""
WHERE = "where"
"""In `Do`: report the line that the plugin is at."""


class PipeMessage(msgspec.Struct, frozen=True, tag=True, array_like=True):
    """One frame."""


class Begin(PipeMessage, frozen=True):
    """Create the plugin; nothing of it is called yet."""

    robot: str
    team: str
    plugin: str
    manifest: str
    """Path of the manifest."""
    class_path: str
    parameters: bytes
    seeds: tuple[int, ...]
    """Of the plugin's generator."""
    connect: list[str]
    clock_offset_ns: int
    """Of the parent's clock: parent and child stamp alike."""
    import_path: list[str]
    memory_mb: int


class Do(PipeMessage, frozen=True):
    """Run a lifecycle function; the answer is the plugin's period."""

    function: str


class ObservedEvent(PipeMessage, frozen=True):
    """An event that the plugin observes has happened."""

    subscription: int
    value: bytes


class CallRequest(PipeMessage, frozen=True):
    """Call a function of the plugin, or of one that it has a handle on."""

    handle: int
    function: str
    arguments: bytes


class Get(PipeMessage, frozen=True):
    """Read an attribute that an interface offers."""

    handle: int
    attribute: str


class Use(PipeMessage, frozen=True):
    """Get hold of another plugin; the answer is the number of the handle."""

    plugin: str
    module: str
    """Where the interface is declared; empty for the plugin's own module."""
    interface: str


class Observe(PipeMessage, frozen=True):
    """Observe an event."""

    handle: int
    event: str
    subscription: int


class ReadBoard(PipeMessage, frozen=True):
    """Read a fact about the robot."""

    name: str


class WriteBoard(PipeMessage, frozen=True):
    """Write a fact about the robot; not answered."""

    name: str
    value: bytes


class Notify(PipeMessage, frozen=True):
    """The plugin notifies one of its events; not answered."""

    event: str
    value: bytes


class Log(PipeMessage, frozen=True):
    """A log record; not answered."""

    level: str
    text: str


class CallReply(PipeMessage, frozen=True):
    """The result of a request."""

    value: bytes = b""


class CallFailure(PipeMessage, frozen=True):
    """The request has raised."""

    kind: str
    """Name of the exception's class."""
    text: str
    attributes: dict[str, str]
    where: str
    """The line of plugin code, as in `Raised`."""
    traceback: str
    """The traceback, as in `Raised`."""


Request = Begin | Do | ObservedEvent | CallRequest | Get | Use | Observe | ReadBoard | WriteBoard | Notify | Log
Frame = Request | CallReply | CallFailure

UNANSWERED = (WriteBoard, Notify, Log)

BOARD_TYPES: dict[str, Any] = {field.name: field.type for field in msgspec.structs.fields(RobotState)} | {
    "T_arena_odom": Pose2D | None,
    "T_odom_robot": Pose2D | None,
    "wheel_ticks": tuple[int, ...] | None,
    "odometry": tuple[tuple[int, Pose2D], ...],
    "published_odometry": tuple[Pose2D, int] | None,
    "wants_odometry": bool,
    "gyro_contradiction": float | None,
    "has_scanned": bool,
    "doubted_scan": list[int] | None,
}
"""The board's facts are those of the state, the frames of dead reckoning, and values that devices keep over a
restart."""
