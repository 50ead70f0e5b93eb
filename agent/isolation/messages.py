"""What passes between a robot's process and that of an isolated plugin. MessagePack, never pickle."""

import msgspec

OWN = 0
"""The handle that stands for the isolated plugin itself."""
WHERE = "where"
"""In `Do`: report the line that the plugin is at."""


class Message(msgspec.Struct, frozen=True, tag=True, array_like=True):
    """One frame."""


class Begin(Message, frozen=True):
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


class Do(Message, frozen=True):
    """Run a lifecycle function; the answer is the plugin's period."""

    function: str


class Told(Message, frozen=True):
    """An event that the plugin observes has happened."""

    subscription: int
    value: bytes


class Call(Message, frozen=True):
    """Call a function of the plugin, or of one that it has a handle on."""

    handle: int
    function: str
    arguments: bytes


class Get(Message, frozen=True):
    """Read an attribute that an interface offers."""

    handle: int
    attribute: str


class Use(Message, frozen=True):
    """Get hold of another plugin; the answer is the number of the handle."""

    plugin: str
    module: str
    """Where the interface is declared; empty for the plugin's own module."""
    interface: str


class Observe(Message, frozen=True):
    """Be told of an event."""

    handle: int
    event: str
    subscription: int


class ReadBoard(Message, frozen=True):
    """Read a fact about the robot."""

    name: str


class WriteBoard(Message, frozen=True):
    """Write a fact about the robot; not answered."""

    name: str
    value: bytes


class Notify(Message, frozen=True):
    """The plugin notifies one of its events; not answered."""

    event: str
    value: bytes


class Log(Message, frozen=True):
    """A log record; not answered."""

    level: str
    text: str


class Answer(Message, frozen=True):
    """What was asked for."""

    value: bytes = b""


class Failure(Message, frozen=True):
    """What was asked for has raised."""

    kind: str
    """Name of the exception's class."""
    text: str
    attributes: dict[str, str]
    where: str
    """The line of plugin code, as in `Raised`."""
    traceback: str
    """The traceback, as in `Raised`."""


Request = Begin | Do | Told | Call | Get | Use | Observe | ReadBoard | WriteBoard | Notify | Log
Frame = Request | Answer | Failure

UNANSWERED = (WriteBoard, Notify, Log)
