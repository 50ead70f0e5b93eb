"""One thing that was looked at, as a value."""

from collections.abc import Sequence
from enum import StrEnum

import msgspec


class CheckName(StrEnum):
    """What is looked at."""

    FILE = "file"
    """The robot's or the team's file."""
    ROUTER = "router"
    KEY_SPACE = "key_space"
    """Whether the router passes on what the robot says under its own keys."""
    CERTIFICATE = "certificate"
    CLOCK = "clock"
    VERSION = "version"
    NAME = "name"
    """Whether another process has the name."""
    ROBOT = "robot"
    """How a robot that runs is."""
    PORT = "port"
    ADDRESS = "address"
    """Whether an address is one of this machine's."""
    CAN = "can"
    DEVICE = "device"
    """Whether a device opens what its parameters name: a file, a bus, a port."""
    EXTRA = "extra"
    """Packages that plugins need."""
    MAP = "map"


class Check(msgspec.Struct, frozen=True):
    """What was found."""

    name: CheckName
    ok: bool | None
    """None if it could not be looked at."""
    sentence: str
    remedy: str = ""
    """What to do about it; empty if nothing is wrong."""


def is_good(checks: Sequence[Check]) -> bool:
    """Whether nothing is wrong; what could not be looked at is not."""
    return all(check.ok is not False for check in checks)
