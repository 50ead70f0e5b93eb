"""One thing that was looked at, as a value."""

from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

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
    PORT = "port"
    ADDRESS = "address"
    """Whether an address is one of this machine's."""
    CAN = "can"
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


class CertificatePaths(NamedTuple):
    """Files of a process that speaks TLS."""

    authority: Path
    """Certificates of whom it trusts."""
    certificate: Path
    key: Path


CertificateCheck = Callable[[CertificatePaths, Sequence[str]], list[Check]]
"""Looks at a process's certificates, given their files and the endpoints that it connects to."""


def is_good(checks: Sequence[Check]) -> bool:
    """Whether nothing is wrong; what could not be looked at is not."""
    return all(check.ok is not False for check in checks)
