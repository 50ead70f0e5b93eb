"""The table of topics: collects the rows that the modules of messages define.

Recorder, replay, documentation and access rules are derived from it. Another distribution adds rows by an entry point,
which names a module with rows or a sequence of rows:

    [project.entry-points."robrain.topics"]
    patrol = "my_team.patrol_messages"
"""

import logging
from collections.abc import Sequence
from functools import cache
from pkgutil import walk_packages
from types import ModuleType
from typing import Any

from robrain.protocol import messages
from robrain.protocol.registry import Registry
from robrain.protocol.topic import OWNERS, Query, Topic, Urgency, WireKey

logger = logging.getLogger(__name__)

HOST_VERB = Query(
    "robot/{robot}/host/{verb}", "Any verb of the host, also one of another distribution; JSON as in its own row",
    bytes, bytes, alias="host_verb", urgency=Urgency.INTERACTIVE_HIGH)  # fmt: skip
"""Stands for the rows of all verbs where the verb is not known beforehand. It is none of the table, which has one row
for each key."""
TOPICS: Registry[ModuleType | Sequence[object]] = Registry(
    "topics",
    "robrain.topics",
    {one.name: one.name for one in walk_packages(messages.__path__, f"{messages.__name__}.")},
)
"""Modules and sequences of rows by name: robrain's own are all modules of messages."""


@cache
def all_rows() -> tuple[WireKey, ...]:
    """All rows, sorted by key. A row of another distribution whose name or keys are taken is left out, and logged."""
    found: dict[str, WireKey] = {}
    for name, entry in TOPICS.entries().items():
        for row in vars(entry).values() if isinstance(entry, ModuleType) else entry:
            if not isinstance(row, WireKey) or found.get(row.name) is row:
                continue
            if refusal := _refusal(row, found):
                logger.error("topics %s: %s is left out: %s", name, row.pattern, refusal)
            else:
                found[row.name] = row
    return tuple(sorted(found.values(), key=lambda row: row.pattern))


@cache
def all_topics() -> tuple[Topic[Any], ...]:
    """The topics among the rows."""
    return tuple(row for row in all_rows() if isinstance(row, Topic))


def topic_of(key: str) -> tuple[Topic[Any], dict[str, str]] | None:
    """The topic of a concrete key, or an earlier version's, and the names in it (with `team`); None if it has none."""
    for topic in all_topics():
        for form in (topic, topic.before):
            if form is not None and (names := form.parse(key)) is not None:
                return topic, names
    return None


def _refusal(row: WireKey, found: dict[str, WireKey]) -> str:
    """Why the table refuses a row, as text; empty if it accepts the row."""
    if row.name in found:
        return f"{found[row.name].pattern} has the name {row.name}"
    if other := next(filter(row.intersects, found.values()), None):
        return f"{other.pattern} has the same keys"
    return "" if row.role or row.chunks[0] in OWNERS else f"expected its role, as {row.chunks[0]}/ has no owner"
