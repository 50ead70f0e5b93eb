"""Team files: the machines of a team, and which parts run on which.

A scenario file has no `[[hosts]]`, so `robrain up FILE` distinguishes the two.
"""

import ipaddress
import re
from collections import Counter
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.deploy.errors import UsageError
from robrain.deploy.supervision.part import ARENA, HUB, STOCK_PARTS
from robrain.protocol.errors import BadName, BadToml
from robrain.protocol.file_mistakes import read_tables
from robrain.protocol.keys import DEFAULT_TEAM, check_name
from robrain.protocol.model.checked import Checked
from robrain.protocol.toml_text import read_toml

HOSTS = "hosts"
PORT = 7447
"""Zenoh's default port."""
_HOST_NAME = re.compile(
    r"(?=.{1,253}$)[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?)*"
)


def _checked(what: str, name: str) -> None:
    try:
        check_name(what, name)
    except BadName as error:
        raise ValueError(str(error)) from error


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return _HOST_NAME.fullmatch(text) is not None
    return True


class SiteTeamTable(Checked, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """`[team]`: settings of all machines."""

    name: str = DEFAULT_TEAM
    """Of the team: every key on the wire begins with it."""
    scenario: str = ""
    """The simulated scenario: a built-in name, or a file relative to this one; empty for real robots."""
    port: Annotated[int, Meta(ge=1, le=65_535)] = PORT
    """Of the hub, at the address of its host."""
    journal: str = ""
    """The coordinator's file, relative to this one; default: NAME.journal beside it."""
    planning: str = ""
    """The coordinator's planning file, relative to this one; a scenario has its own."""
    rules: str = ""
    """The coordinator's rules file, relative to this one; a scenario has its own."""
    floor: str = ""
    """The coordinator's known floor, a map.yaml or a recording, relative to this file; a scenario has its own."""
    record: str = ""
    """The recorder's file, relative to this one; default: runs/NAME-N.mcap with the first free number."""
    dashboard_port: Annotated[int, Meta(ge=0, le=65_535)] | None = None
    """Of the page, on loopback of its host; 8080 if absent, or a free one if that is taken."""
    pki: str = ""
    """Folder of the certificates of a secured team, relative to this file; empty for a plain one. With the CA's key in
    it the certificates that are missing are made."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _checked("team", self.name)
        for key in ("planning", "rules", "floor"):
            if self.scenario and getattr(self, key):
                raise ValueError(f"{key}: expected no such file, because the scenario has its own")


class HostTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[[hosts]]`: one machine and its parts. Each part is on one machine, and one machine has the hub."""

    name: str
    """Name for `--host`; need not be the machine's own name."""
    address: str
    """IP address or host name at which the other machines reach it."""
    parts: list[str]
    """`hub`, `arena`, `coordinator`, `stand-by`, `recorder`, `dashboard`, and names of robots."""

    def __post_init__(self) -> None:
        _checked("host", self.name)
        if not _is_address(self.address):
            raise ValueError(f"address: expected an IP address or a host name, got {self.address!r}")
        if not self.parts:
            raise ValueError(f"parts: expected at least one of {', '.join(STOCK_PARTS)} or a robot's name")
        for part in self.parts:
            if part not in STOCK_PARTS:
                _checked("robot", part)
        if twice := [part for part, count in Counter(self.parts).items() if count > 1]:
            raise ValueError(f"parts: expected {twice[0]} once")

    @property
    def robots(self) -> list[str]:
        """Names of the robots whose agents run there."""
        return [part for part in self.parts if part not in STOCK_PARTS]


class TeamFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file."""

    hosts: list[HostTable]
    team: SiteTeamTable = SiteTeamTable()
    robots: dict[str, str] = {}
    """ROBOT.toml of each robot, relative to this file; robots of the scenario need none."""

    def __post_init__(self) -> None:
        where = Counter(host.name for host in self.hosts)
        if twice := [name for name, count in where.items() if count > 1]:
            raise ValueError(f"hosts: expected each name once, got {twice[0]} {where[twice[0]]} times")
        hosts_of: dict[str, list[str]] = {}
        for host in self.hosts:
            for part in host.parts:
                hosts_of.setdefault(part, []).append(host.name)
        for part, names in hosts_of.items():
            if len(names) > 1:
                raise ValueError(f"hosts: expected {part} on one host, got {', '.join(names)}")
        if HUB not in hosts_of:
            raise ValueError("hosts: expected one with the part hub, to which all others connect")
        if ARENA in hosts_of and not self.team.scenario:
            raise ValueError("team.scenario: expected a scenario for the part arena, got none")
        for robot in self.robots:
            _checked("robot", robot)
        if not self.team.scenario:
            unknown = [part for part in hosts_of if part not in STOCK_PARTS and part not in self.robots]
            if unknown:
                raise ValueError(f"robots: expected the ROBOT.toml of {unknown[0]}, as there is no scenario")

    @property
    def hub_host(self) -> HostTable:
        """The host with the hub."""
        return next(host for host in self.hosts if HUB in host.parts)

    @property
    def endpoint(self) -> str:
        """Endpoint of the hub."""
        address = self.hub_host.address
        return f"{'tls' if self.team.pki else 'tcp'}/{f'[{address}]' if ':' in address else address}:{self.team.port}"

    def host(self, path: Path, name: str | None) -> HostTable:
        """The host of a name; without one the only host, or else a UsageError that lists all."""
        names = ", ".join(host.name for host in self.hosts)
        if name is None:
            if len(self.hosts) == 1:
                return self.hosts[0]
            raise UsageError(f"{path}: expected --host with one of {names}")
        for host in self.hosts:
            if host.name == name:
                return host
        raise UsageError(f"--host {name}: expected one of {names} ({path})")


def is_team_file(path: Path) -> bool:
    """Whether a file can be read and has `[[hosts]]`."""
    try:
        return HOSTS in read_toml(path)
    except BadToml:
        return False


def read_team_file(path: Path) -> TeamFile:
    """Read a team file.

    Raises:
        UsageError: naming file, key and expected value.

    """
    try:
        found = read_tables(path, TeamFile)
    except BadToml as error:
        raise UsageError(f"{path}: {error}") from error
    files = {"team.planning": found.team.planning, "team.rules": found.team.rules, "team.floor": found.team.floor}
    for key, file in files.items():
        if file and not (path.parent / file).is_file():
            raise UsageError(f"{path}: {key}: expected a file, found none at {path.parent / file}")
    for robot, file in found.robots.items():
        if not (path.parent / file).is_file():
            raise UsageError(f"{path}: robots.{robot}: expected a file, found none at {path.parent / file}")
    return found
