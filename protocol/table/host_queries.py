"""The rows of the verbs of a robot's host. `topics.TOPICS` includes them.

A verb of another distribution has its own row, made by `host_query`, under the same keys; it is in no table.
"""

from robrain.protocol.errors import PLUGIN_ERRORS, START_ERRORS, ErrorCode
from robrain.protocol.messages.robots.host_messages import (
    CommandRequest,
    HaltAnswer,
    HaltRequest,
    HoldRequest,
    Lease,
    LoadRequest,
    ReleaseRequest,
    ReloadRequest,
    ResumeRequest,
    UnloadRequest,
)
from robrain.protocol.messages.robots.plugin_messages import PluginInfo
from robrain.protocol.table.topic import ANSWER_S, Q, Query, R, Urgency

HOST_S = 10.0
"""Time limit for a verb unless its row has another."""
CHANGE_S = 60.0
"""Time limit for a load: it imports code, which may compile some of itself."""
HOST_VERB = Query("robot/{robot}/host/{verb}",
                  "Any verb of the host, also one of another distribution; JSON as in its own row",
                  bytes, bytes, alias="host_verb", urgency=Urgency.INTERACTIVE_HIGH)  # fmt: skip
"""Stands for the rows of all verbs where the verb is not known beforehand. It is none of the table, which has one row
for each key."""


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
    return Query(HOST_VERB.pattern.replace("{verb}", verb), doc, request, reply, alias=f"host_{verb}",
                 urgency=Urgency.INTERACTIVE_HIGH, errors=errors, timeout_s=timeout_s)  # fmt: skip


HOST_LOAD = host_query("load", LoadRequest, list[PluginInfo],
                       "Load a plugin, with what it requires: replies all that were loaded",
                       *START_ERRORS, timeout_s=CHANGE_S)  # fmt: skip
HOST_UNLOAD = host_query("unload", UnloadRequest, list[PluginInfo], "Unload a plugin: replies all that were unloaded",
                         ErrorCode.UNKNOWN_PLUGIN, ErrorCode.REFUSED, timeout_s=CHANGE_S)  # fmt: skip
HOST_RELOAD = host_query("reload", ReloadRequest, list[PluginInfo],
                         "Load a new version of a plugin: replies the new one; if it cannot start, the old one keeps "
                         "running",
                         *START_ERRORS, timeout_s=CHANGE_S)  # fmt: skip
HOST_COMMAND = host_query("command", CommandRequest, str, "Execute a command in text form: replies its result as text",
                          *PLUGIN_ERRORS)  # fmt: skip
HOST_HOLD = host_query("hold", HoldRequest, Lease, "Get or extend the exclusive use of a plugin for a time",
                       *START_ERRORS, ErrorCode.HALTED)  # fmt: skip
HOST_RELEASE = host_query("release", ReleaseRequest, bool,
                          "End the exclusive use of a plugin: replies false if it was not held, or no longer",
                          ErrorCode.UNKNOWN_PLUGIN)  # fmt: skip
HOST_HALT = host_query("halt", HaltRequest, HaltAnswer,
                       "Emergency halt of this robot alone: replies when it has ordered its plugins to stop",
                       timeout_s=ANSWER_S)  # fmt: skip
HOST_RESUME = host_query("resume", ResumeRequest, HaltAnswer,
                         "End of the robot's halt, whether of this robot alone or of the team",
                         ErrorCode.REFUSED, timeout_s=ANSWER_S)  # fmt: skip
HOST_QUERIES = (HOST_LOAD, HOST_UNLOAD, HOST_RELOAD, HOST_COMMAND, HOST_HOLD, HOST_RELEASE, HOST_HALT, HOST_RESUME)
"""The rows of the verbs of a robot's host."""
