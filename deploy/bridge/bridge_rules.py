"""The file of a bridge: its two sides, and what passes from one to the other."""

from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from robrain.deploy.run.table_file import read_tables
from robrain.protocol.wire.errors import RobrainError
from robrain.protocol.wire.keys import is_name
from robrain.protocol.wire.session import check_endpoint
from robrain.protocol.wire.topic import Query, Role, Topic, WireKey
from robrain.protocol.wire.topics import TOPICS

RULES_MAX = 64
ROBOT = "robot"
PASSABLE = (Role.ROBOT, Role.OPERATOR)
"""Whose topics may pass. What a coordinator says would be taken for the other team's own coordinator's words."""
SIMULATED = "arena/"


class Side(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A team, and where it is reached."""

    team: str
    connect: list[str] = []
    """Endpoints of its router; none for that of `--connect`, or else this machine's hub."""
    network: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.\-]*$", max_length=63)] = ""
    """Names the routers that know of each other. All bridges must use the same names, which is how they find loops."""

    @property
    def id(self) -> str:
        """Names the side for all bridges."""
        return f"{self.network}/{self.team}"


class PassRule(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What passes in one direction."""

    source: str = msgspec.field(name="from")
    """Side where it is said or asked."""
    target: str = msgspec.field(name="to")
    """Side that hears or answers it."""
    topics: list[str] = []
    """Names of rows of the table of topics."""
    queries: list[str] = []
    """Names of queries that robots answer."""
    robots: list[str] = []
    """Only of, or to, these; all if empty."""


class BridgeRules(msgspec.Struct, frozen=True, kw_only=True):
    """A bridge's file.

    Raises:
        ValueError: a side or rule is wrong; the text says what was expected.

    """

    sides: dict[str, Side]
    rules: Annotated[list[PassRule], Meta(min_length=1, max_length=RULES_MAX)]

    def __post_init__(self) -> None:
        if len(self.sides) != 2:
            raise ValueError(f"expected two tables [sides.NAME], got {len(self.sides)}")
        for name, side in self.sides.items():
            if not is_name(side.team):
                raise ValueError(f"expected the name of a team, got {side.team!r} (sides.{name})")
            try:
                for endpoint in side.connect:
                    check_endpoint(endpoint)
            except RobrainError as error:
                raise ValueError(f"{error} (sides.{name})") from error
        first, second = self.sides.values()
        if first.id == second.id:
            raise ValueError(f"expected two teams, or the networks of two routers: both sides are team {first.team}")
        for rule in self.rules:
            if {rule.source, rule.target} != set(self.sides):
                raise ValueError(
                    f"expected from and to among {', '.join(self.sides)}, got {rule.source}, {rule.target}"
                )
            if not rule.topics and not rule.queries:
                raise ValueError("expected topics or queries in each of [[rules]]")
            for name in rule.topics:
                passable_topic(name)
            for name in rule.queries:
                passable_query(name)


def passable_topic(name: str) -> Topic[Any]:
    """A topic that may pass (ValueError)."""
    found = {row.name: row for row in TOPICS if isinstance(row, Topic) and _may_pass(row)}
    if name not in found:
        raise ValueError(f"topic {name}: expected one of {', '.join(sorted(found))}")
    return found[name]


def passable_query(name: str) -> Query[Any, Any]:
    """A query that may pass: one that names the robot that answers it (ValueError)."""
    found = {row.name: row for row in TOPICS if isinstance(row, Query) and row.fields[:1] == (ROBOT,)}
    found = {key: row for key, row in found.items() if row.by is Role.ROBOT and _may_pass(row)}
    if name not in found:
        raise ValueError(f"query {name}: expected one of {', '.join(sorted(found))}")
    return found[name]


def read_bridge(path: Path) -> BridgeRules:
    """Read a bridge's file.

    Raises:
        UsageError: naming file, key and what was expected.

    """
    return read_tables(path, BridgeRules, "bridge")


def _may_pass(row: WireKey) -> bool:
    return row.by in PASSABLE and not row.pattern.startswith(SIMULATED)
