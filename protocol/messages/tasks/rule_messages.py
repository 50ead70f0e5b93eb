"""The team's rules, and changes of them."""

from types import NoneType
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.errors import ErrorCode
from robrain.protocol.model.ranges import Count, Name, Names, Stamp, Text
from robrain.protocol.model.rules.rule import RULES_MAX, Rule
from robrain.protocol.topic import Query, Urgency


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
    next_ns: Stamp = 0
    """When its schedule is due next; 0 if it has none."""


RuleList = Annotated[list[Rule], Meta(max_length=RULES_MAX)]


class RuleTable(msgspec.Struct, frozen=True, kw_only=True):
    """All rules of the team."""

    rules: RuleList
    """In the order of the file, then those that were added."""
    states: Annotated[list[RuleStatus], Meta(max_length=RULES_MAX)]
    """Of each rule, in the same order."""


class RuleChange(msgspec.Struct, frozen=True, kw_only=True):
    """Rules to add, to replace or to remove. As in a file, an unknown field of a rule is refused, not ignored."""

    put: RuleList = []
    """New rules; each replaces the rule with its name, if there is one."""
    remove: Names = []
    """Names of rules that end."""
    by: Text = ""
    """Name of the requester."""


COORDINATOR_RULES_NOW = Query(
    "coordinator/rules/now", "All rules of the team", NoneType, RuleTable, alias="coordinator_rules_now",
    urgency=Urgency.DATA_HIGH, reads_only=True)  # fmt: skip
COORDINATOR_RULES_CHANGE = Query(
    "coordinator/rules/change", "Add, replace or remove rules; replies all rules", RuleChange, RuleTable,
    alias="coordinator_rules_change", urgency=Urgency.DATA_HIGH, errors=(ErrorCode.REFUSED, ))  # fmt: skip
