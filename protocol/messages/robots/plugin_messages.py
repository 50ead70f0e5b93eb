"""Reports of a robot about its plugins: their functions and events, their log, the process that runs them."""

from types import NoneType
from typing import Annotated, Any, Self

import msgspec
from msgspec import Meta

from robrain.protocol.errors import PLUGIN_ERRORS
from robrain.protocol.messages.message import JsonSchema, Message, Prose
from robrain.protocol.model.ranges import Count, Name, Names, Seconds, Text
from robrain.protocol.topic import Delivery, Query, Token, Topic, Urgency


class PluginEvent(Message, frozen=True, kw_only=True):
    """A notification that left its robot."""

    robot: Name
    plugin: Name
    event: Name
    value: Any = None
    """Value of the plugin's notification, any JSON."""

    def moved_in_time(self, by_ns: int) -> Self:
        """The event with its stamp moved, from its sender's clock to the receiver's."""
        return msgspec.structs.replace(self, stamp_ns=self.stamp_ns + by_ns)


class LogRecord(Message, frozen=True, kw_only=True):
    """One line of a component's log."""

    robot: Name
    level: Name
    """Level as in Python: debug, info, warning, error."""
    source: Name
    """Name of the plugin or part that logs."""
    text: Text
    """The line."""


class FunctionInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One external function of a plugin."""

    name: Name
    signature: Prose
    """Its signature in Python."""
    doc: Prose
    parameters: JsonSchema
    """JSON Schema of an object with one property for each parameter."""
    returns: JsonSchema
    """JSON Schema of the result."""
    starts_action: bool = False
    """Whether it starts a long action and returns its id; the event `finished` reports the action's end."""


class ProcessInfo(msgspec.Struct, frozen=True):
    """Which process has a name."""

    host: Text
    """Name of its machine."""
    pid: Count
    """Its process id there."""
    zid: Text
    """Id of its Zenoh session."""
    version: Text = ""
    """Version of its robrain; empty if it is older than this field."""

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, Zenoh id {self.zid[:8]}"


class TaskKind(msgspec.Struct, frozen=True, kw_only=True):
    """A kind of task that a behavior does, as its robot announces it."""

    kind: Name
    doc: Prose = ""
    parameters: JsonSchema = {}
    """JSON Schema of `Task.parameters`: of an object; no references but to its own `$defs`, no regular expressions."""
    settings: Count = 0
    """Differs between robots whose behavior has other parameters, so that tasks may have other costs for them."""


class PluginInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One plugin of a robot, as its host reports it."""

    name: Name
    level: Name
    """Device, unit, skill or behavior."""
    state: Name
    why: Text = ""
    because_of: Name = ""
    """The plugin because of which it does not run; empty if the reason is its own."""
    needs: Name = ""
    """The extra whose absence prevents its start, such as `robrain[navigation]`; empty if the reason is another."""
    where: Text = ""
    """The line of plugin code that raised the fault, such as `lamp/lamp.py:12 in step`; empty if none did."""
    detail: Text = ""
    """The traceback of the fault, from the plugin's first frame."""
    visibility: Names = []
    """Plugins that may call it; `*` for all, `command` for callers outside."""
    requires: Names = []
    """Plugins that it calls."""
    holder: Name = ""
    period_s: Seconds | None = None
    overruns: Count = 0
    """Steps that took longer than the period."""
    restarts: Count = 0
    """How often it was started again after a fault."""
    distribution: Name = ""
    """The installed distribution that a third-party plugin came with."""
    doc: Prose = ""
    functions: Annotated[list[FunctionInfo], Meta(max_length=1000)] = []
    task_kind: TaskKind | None = None
    """The kind of task that it does; None if it does none."""

    @property
    def reason(self) -> str:
        """Reason of its state, without that of the plugin because of which it does not run."""
        return f"because of {self.because_of}" if self.because_of else self.why


ROBOT_WHO = Query(
    "robot/{robot}/who", "Process that holds the robot's name: replies host, process id, Zenoh id and version",
    NoneType, ProcessInfo, reads_only=True)  # fmt: skip
ROBOT_PLUGINS = Query(
    "robot/{robot}/plugins", "Loaded plugins with state and functions", NoneType, list[PluginInfo],
    reads_only=True)  # fmt: skip
ROBOT_CALL = Query(
    "robot/{robot}/call/{plugin}/{function}",
    "External call: arguments as a JSON array (by position) or object (by name), reply is the JSON result; the "
    "holder of an exclusive plugin names itself with `?by=NAME` behind the key", bytes, bytes,
    urgency=Urgency.INTERACTIVE_HIGH, errors=PLUGIN_ERRORS)  # fmt: skip
ROBOT_EVENT = Topic(
    "robot/{robot}/event/{plugin}/{event}", "Events that the robot publishes", PluginEvent, delivery=Delivery.LOSSLESS,
    cache=256, urgency=Urgency.INTERACTIVE_HIGH, recorded=True)  # fmt: skip
ROBOT_LOG = Topic(
    "robot/{robot}/log", "Log records", LogRecord, urgency=Urgency.DATA_LOW, recorded=True,
    max_bytes=65_536)  # fmt: skip
ROBOT_LOG_KEPT = Query(
    "robot/{robot}/log/kept", "The last log records of each plugin and part, oldest first", NoneType, list[LogRecord],
    reads_only=True)  # fmt: skip
ROBOT_FOREIGN = Token(
    "robot/{robot}/foreign/{plugin}",
    "Liveliness token of a plugin that is a separate process, in any language")  # fmt: skip
ROBOT_FOREIGN_INFO = Query(
    "robot/{robot}/foreign/{plugin}/info", "Description of such a plugin: replies a `PluginInfo`", NoneType, PluginInfo,
    reads_only=True)  # fmt: skip
ROBOT_FOREIGN_CALL = Query(
    "robot/{robot}/foreign/{plugin}/call/{function}",
    "External call of such a plugin, relayed by the robot's host; arguments and reply as for `call`", bytes, bytes,
    urgency=Urgency.INTERACTIVE_HIGH, errors=PLUGIN_ERRORS)  # fmt: skip
