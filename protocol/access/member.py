"""Members of a secured team: the name and role in a certificate."""

from enum import StrEnum
from typing import NamedTuple

from robrain.protocol.errors import BadName
from robrain.protocol.keys import check_name

LONGEST_COMMON_NAME = 64
"""Characters that X.509 allows for a common name."""


class MemberRole(StrEnum):
    """Purpose of a certificate."""

    ROUTER = "router"
    COORDINATOR = "coordinator"
    OPERATOR = "operator"
    """A person, or a program, that gives orders."""
    VIEWER = "viewer"
    """Sees everything and changes nothing."""
    RECORDER = "recorder"
    """Records: as a viewer, and publishes its own state."""
    DASHBOARD = "dashboard"
    """A page that others look at: it may halt the team, submit tasks, and cancel its own."""
    ROBOT = "robot"
    ARENA = "arena"
    """The simulator, in place of the robots' hardware."""


MEMBERS = tuple(role for role in MemberRole if role is not MemberRole.ROUTER)
"""Roles of those that connect to a router."""


class Member(NamedTuple):
    """One member of a team. Its text names it in records: `operator:ann`."""

    role: MemberRole
    team: str
    name: str

    def __str__(self) -> str:
        return f"{self.role}:{self.name}"

    @property
    def common_name(self) -> str:
        """The common name of its certificate, which the router's rules name.

        >>> Member(MemberRole.ROBOT, "blue", "r1").common_name
        'robot:blue:r1'
        """
        return f"{self.role}:{self.team}:{self.name}"

    @property
    def is_operator(self) -> bool:
        """Whether it has the rights of an operator."""
        return self.role is MemberRole.OPERATOR


def member(role: str, team: str, name: str) -> Member:
    """A member that a certificate can name.

    Raises:
        BadName: the role is none, a name cannot be part of a key, or both names together are too long.

    """
    if role not in tuple(MemberRole):
        raise BadName("role", role, f"expected one of {', '.join(MemberRole)}")
    one = Member(MemberRole(role), check_name("team", team), check_name(role, name))
    if len(one.common_name) > LONGEST_COMMON_NAME:
        more = len(one.common_name) - LONGEST_COMMON_NAME
        raise BadName(role, name, f"role, team and name are {more} characters too long together for a certificate")
    return one


def member_of(common_name: str) -> Member | None:
    """The member that a certificate's common name means; None if it is not one of robrain's.

    >>> member_of("robot:blue:r1")
    Member(role=<MemberRole.ROBOT: 'robot'>, team='blue', name='r1')
    >>> member_of("example.org")
    """
    parts = common_name.split(":")
    if len(parts) != 3:
        return None
    try:
        return member(*parts)
    except BadName:
        return None
