"""The verbs of a robot's host: the request and the reply of each."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Name, Names, Stamp, Text

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
