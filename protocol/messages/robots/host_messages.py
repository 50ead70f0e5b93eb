"""The verbs of a robot's host: the request and the reply of each."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.errors import PLUGIN_ERRORS, START_ERRORS, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import PluginInfo
from robrain.protocol.model.ranges import Name, Names, Stamp, Text
from robrain.protocol.topic import ANSWER_S, Q, Query, R, Urgency

LONGEST_LEASE_S = 60.0
"""A holder that needs a plugin for longer renews its lease; one that has gone does not block the plugin for ever."""
Words = Annotated[str, Meta(max_length=1_000_000)]


class LoadRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Load a plugin into a running robot, with the plugins that it requires."""

    plugin: Text
    """Its name, or the path of its folder or manifest on the robot's machine."""


class UnloadRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Unload a plugin."""

    plugin: Name
    cascade: bool = False
    """Whether to unload also the plugins that require it."""


class ReloadRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Load a plugin again in place of the one that runs."""

    plugin: Name


class CommandRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Execute a command in text form."""

    text: Words
    """The command, such as `call driver stop()`."""
    by: Text = ""
    """Name of the caller: a plugin that has a holder accepts calls from its holder alone."""


class HoldRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Have exclusive use of a plugin."""

    plugin: Name
    by: Name
    """The holder."""
    lease_s: Annotated[float, Meta(gt=0.0, le=LONGEST_LEASE_S)] = 5.0
    """For how long; ask again in time to hold it longer."""


class ReleaseRequest(msgspec.Struct, frozen=True, kw_only=True):
    """End the exclusive use of a plugin."""

    plugin: Name
    by: Name
    """The holder."""


class HaltRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Halt one robot."""

    by: Text = ""
    """Name of the sender of the halt. The same name, or one that starts with `operator`, may resume."""
    reason: Words = ""
    """For the logs; its first 200 characters are kept."""


class ResumeRequest(msgspec.Struct, frozen=True, kw_only=True):
    """End the halt of one robot."""

    by: Text = ""


class Lease(msgspec.Struct, frozen=True, kw_only=True):
    """An outside holder's right to a plugin."""

    plugin: Name
    holder: Name
    """Name of the holder, which has exclusive use of it."""
    until_ns: Stamp
    """By the robot's clock."""


class HaltAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """How a robot stands to a halt, after it was halted or resumed by a query."""

    robot: Name
    halted: bool
    by: Names = []
    """Names of the holders of the halt."""
    not_halted: Names = []
    """Plugins that failed to stop, or did not confirm in time that they have."""


HOST_S = 10.0
"""Time limit for a verb unless its row has another."""
CHANGE_S = 60.0
"""Time limit for a load: it imports code, which may compile some of itself."""


def host_query(
    verb: str, request: type[Q], reply: type[R], doc: str, *errors: ErrorCode, timeout_s: float = HOST_S
) -> Query[Q, R]:
    """The row of a verb, `robot/{robot}/host/VERB`.

    Args:
        verb: its name, the last chunk of the key.
        request: a struct with ranges in its types.
        reply: type of the reply.
        doc: its effect, for the table.
        errors: its possible replies, besides the errors of every query.
        timeout_s: how long to wait for the reply.

    """
    return Query(f"robot/{{robot}}/host/{verb}", doc, request, reply, alias=f"host_{verb}",
                 urgency=Urgency.INTERACTIVE_HIGH, errors=errors, timeout_s=timeout_s)  # fmt: skip


HOST_LOAD = host_query(
    "load", LoadRequest, list[PluginInfo], "Load a plugin, with what it requires: replies all that were loaded",
    *START_ERRORS, timeout_s=CHANGE_S)  # fmt: skip
HOST_UNLOAD = host_query(
    "unload", UnloadRequest, list[PluginInfo], "Unload a plugin: replies all that were unloaded",
    ErrorCode.UNKNOWN_PLUGIN, ErrorCode.REFUSED, timeout_s=CHANGE_S)  # fmt: skip
HOST_RELOAD = host_query(
    "reload", ReloadRequest, list[PluginInfo],
    "Load a new version of a plugin: replies the new one; if it cannot start, the old one keeps running", *START_ERRORS,
    timeout_s=CHANGE_S)  # fmt: skip
HOST_COMMAND = host_query(
    "command", CommandRequest, str, "Execute a command in text form: replies its result as text",
    *PLUGIN_ERRORS)  # fmt: skip
HOST_HOLD = host_query(
    "hold", HoldRequest, Lease, "Get or extend the exclusive use of a plugin for a time", *START_ERRORS,
    ErrorCode.HALTED)  # fmt: skip
HOST_RELEASE = host_query(
    "release", ReleaseRequest, bool,
    "End the exclusive use of a plugin: replies false if it was not held, or no longer",
    ErrorCode.UNKNOWN_PLUGIN)  # fmt: skip
HOST_HALT = host_query(
    "halt", HaltRequest, HaltAnswer,
    "Emergency halt of this robot alone: replies when it has ordered its plugins to stop",
    timeout_s=ANSWER_S)  # fmt: skip
HOST_RESUME = host_query(
    "resume", ResumeRequest, HaltAnswer, "End of the robot's halt, whether of this robot alone or of the team",
    ErrorCode.REFUSED, timeout_s=ANSWER_S)  # fmt: skip
