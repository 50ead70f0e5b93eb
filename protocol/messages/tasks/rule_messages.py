"""Messages of the coordinator about its rules."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Count, Name, Stamp, Text


class RuleStatus(msgspec.Struct, frozen=True, kw_only=True):
    """One rule, and its actions since the coordinator started."""

    name: Name
    waits: Text = ""
    """Its trigger, and the kind of task that it then makes, as text."""
    made: Count = 0
    """Tasks that it has made."""
    open: Count = 0
    """Its tasks that have not ended, those of earlier coordinators included."""
    alarms: Count = 0
    """Motes for which it has made a task and that have not been clear since; 1 for all, if it is one for the team."""
    refused: Count = 0
    """Tasks that it would have made, had they been possible."""
    why: Text = ""
    """Why the last of these was not, in words."""
    last_ns: Stamp = 0
    """When it made the last one; 0 if it has made none."""


Rules = Annotated[list[RuleStatus], Meta(max_length=1000)] | msgspec.UnsetType
"""Absent if there are no rules."""
