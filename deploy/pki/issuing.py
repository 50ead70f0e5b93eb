"""Functions of `robrain pki`: make a CA; issue, renew and revoke certificates; keep the routers' files up to date.

A team's folder has the certificate `ca.pem` and the key `ca.key` of the CA (0600): its holder can issue certificates.
`members.json` lists members with a certificate, and revoked ones.
In `members/` is a folder for each member, such as `robot.r1`: `ca.pem`, `certificate.pem`, `key.pem` (0600).
That of a router also has `members.json` and `zenohd.json5`.
"""

import fcntl
import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta

from robrain.deploy.command_line.options import write_file
from robrain.deploy.errors import PkiError
from robrain.protocol.access.identity import CA, CERTIFICATE, KEY, RENEW_BELOW, check_private
from robrain.protocol.access.member import Member, MemberRole, member
from robrain.protocol.access.rules import access_control
from robrain.protocol.errors import BadName, WireError
from robrain.protocol.extras import missing_package
from robrain.protocol.keys import check_name
from robrain.protocol.wire.session import LEASE_MS, check_endpoint

CA_CERTIFICATE, CA_KEY, MEMBERS_FILE, MEMBERS_FOLDER = "ca.pem", "ca.key", "members.json", "members"
LOCK_FILE = ".lock"
PRIVATE, PUBLIC, FOLDER = 0o600, 0o644, 0o700


class IssuedCertificate(msgspec.Struct, frozen=True, kw_only=True):
    """A certificate that the CA has issued; of each member the last one."""

    role: str
    team: str
    name: str
    serial: Annotated[str, Meta(max_length=64)]
    """Hexadecimal."""
    not_after: datetime
    days: float
    """Length of its life, for the next."""
    hosts: list[str] = []
    """Names and addresses of the machine, for routers."""
    revoked: bool = False

    @property
    def member(self) -> Member:
        """Its member (BadName if the file was changed to hold a bad name)."""
        return member(self.role, self.team, self.name)


class MembersFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`members.json`."""

    team: str
    members: list[IssuedCertificate] = []

    @property
    def allowed(self) -> list[Member]:
        """Members whose certificates are not revoked."""
        return [one.member for one in self.members if not one.revoked]

    def find(self, wanted: Member) -> IssuedCertificate | None:
        """A member's certificate, if one was issued."""
        return next((one for one in self.members if one.member == wanted), None)

    def having(self, issued: IssuedCertificate) -> "MembersFile":
        """The same with a certificate in place of its member's last one."""
        others = [one for one in self.members if one.member != issued.member]
        return msgspec.structs.replace(self, members=sorted([*others, issued], key=lambda one: one.member))


def folder_of(pki: Path, wanted: Member) -> Path:
    """The folder for one member, to copy to its machine."""
    team = "" if wanted.team == read_members(pki / MEMBERS_FILE).team else f"@{wanted.team}"  # no name has an @
    return pki / MEMBERS_FOLDER / f"{wanted.role}.{wanted.name}{team}"


def read_members(path: Path) -> MembersFile:
    """Read `members.json`.

    Raises:
        PkiError: naming file and key.

    """
    try:
        found = msgspec.json.decode(path.read_bytes(), type=MembersFile)
        for one in found.members:
            one.member  # noqa: B018  # checks the names
    except FileNotFoundError as error:
        raise PkiError(f"{path}: no such file; `robrain pki init {path.parent}` makes one") from error
    except (msgspec.DecodeError, BadName) as error:
        raise PkiError(f"{path}: {error}") from error
    except OSError as error:
        raise PkiError(f"{path}: it cannot be read: {error.strerror}") from error
    return found


@contextmanager
def changing(pki: Path) -> Iterator[MembersFile]:
    """The members, locked against other changes: a renewal must not undo a simultaneous revocation.

    Raises:
        PkiError: naming file and key.

    """
    path = pki / MEMBERS_FILE
    read_members(path)
    with os.fdopen(os.open(pki / LOCK_FILE, os.O_RDWR | os.O_CREAT, PRIVATE), "rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield read_members(path)


def make_folder(path: Path) -> None:
    """Make a folder that only its owner can enter."""
    path.mkdir(mode=FOLDER, parents=True, exist_ok=True)
    path.chmod(FOLDER)


ZENOHD_FILE = "zenohd.json5"
ZENOHD_PORT = 7447


LISTEN = (f"tls/127.0.0.1:{ZENOHD_PORT}",)
"""This machine alone."""


class Endpoints(NamedTuple):
    """Endpoints of a router, and of the other routers that it connects to."""

    listen: tuple[str, ...] = LISTEN
    connect: tuple[str, ...] = ()


DEFAULT_ENDPOINTS = Endpoints()


def endpoints_of(path: Path) -> Endpoints:
    """The endpoints of a file written before, which the router's owner may have changed; `LISTEN` if they are lost."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        settings = json.loads("\n".join(line for line in lines if not line.lstrip().startswith("//")))
        listen = tuple(check_endpoint(one) for one in settings["listen"]["endpoints"])
        connect = tuple(check_endpoint(one) for one in settings.get("connect", {}).get("endpoints", ()))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, WireError):
        return DEFAULT_ENDPOINTS
    return Endpoints(listen or LISTEN, connect)


def zenohd_text(members: Sequence[Member], router: Member | None = None, at: Endpoints = DEFAULT_ENDPOINTS) -> str:
    """The text of a file for `zenohd -c`, to be run in the router's folder: its paths are relative."""
    settings: dict[str, Any] = {
        "mode": "router",
        "listen": {"endpoints": list(at.listen)},
        "connect": {"endpoints": list(at.connect)},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "adminspace": {"enabled": False},
        "timestamping": {"enabled": True},
        "transport": {
            "link": {
                "protocols": ["tls"],
                "tx": {"lease": LEASE_MS},
                "tls": {
                    "root_ca_certificate": CA,
                    "enable_mtls": True,
                    "close_link_on_expiration": True,
                    "listen_certificate": CERTIFICATE,
                    "listen_private_key": KEY,
                    "connect_certificate": CERTIFICATE,
                    "connect_private_key": KEY,
                    "verify_name_on_connect": True,
                },
            },
            "shared_memory": {"enabled": False},
        },
        "access_control": access_control(members, router),
    }
    return (
        "// Written by `robrain pki` with each change of the members; start zenohd in this folder.\n"
        "// To be reached from other machines, change listen.endpoints; other routers are in connect.endpoints.\n"
        + json.dumps(settings, indent=1)
        + "\n"
    )


DAYS = 7.0
"""Life of a certificate unless more is asked for."""
ROUTER_HOSTS = ("localhost", "127.0.0.1")
_LABEL = "[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?"
_NAME = re.compile(rf"{_LABEL}(\.{_LABEL})*")


def init(pki: Path, team: str, now: datetime) -> None:
    """Make a CA and the folder for its team.

    Raises:
        PkiError: the folder has a CA.
        BadName: the team's name cannot be one.

    """
    check_name("team", team)
    if (pki / CA_KEY).exists() or (pki / MEMBERS_FILE).exists():
        raise PkiError(f"{pki}: there is a CA in this folder; choose another folder")
    _need_cryptography(pki)
    from robrain.deploy.pki.authority import Authority

    make_folder(pki)
    make_folder(pki / MEMBERS_FOLDER)
    pair = Authority.create(team, now)
    write_file(pki / CA_KEY, pair.key)
    write_file(pki / CA_CERTIFICATE, pair.certificate, PUBLIC)
    write_file(pki / MEMBERS_FILE, msgspec.json.format(msgspec.json.encode(MembersFile(team=team))))


def issue(pki: Path, wanted: Member, now: datetime, days: float = DAYS, hosts: Sequence[str] = ()) -> IssuedCertificate:
    """Issue a certificate, and write the folder for the member's machine.

    Raises:
        PkiError: the member has a certificate, or had one that was revoked; `renew` is for such members.

    """
    if hosts and wanted.role is not MemberRole.ROUTER:
        raise PkiError(f"--host {hosts[0]}: only for routers, got {wanted}")
    for host in hosts:
        if not _is_host(host):
            raise PkiError(f"--host {host}: expected the name or address of one machine, such as 10.0.0.5 or hall.lan")
    if wanted.role is MemberRole.ROUTER:
        hosts = list(dict.fromkeys((*ROUTER_HOSTS, *hosts)))
    with changing(pki) as members:
        known = members.find(wanted)
        if known is not None and known.revoked:
            raise PkiError(f"{pki / MEMBERS_FILE}: {wanted} is revoked: choose another name for its successor")
        if known is not None:
            raise PkiError(f"{pki / MEMBERS_FILE}: {wanted} has a certificate; `robrain pki renew` makes a new one")
        return _issue(pki, members, wanted, now, days, tuple(hosts))


def _is_host(text: str) -> bool:
    """Whether it is one machine's name or address: with a wildcard a router's certificate would pass for others'."""
    try:
        ip_address(text)
    except ValueError:
        return len(text) <= 253 and _NAME.fullmatch(text) is not None
    return True


def renew(pki: Path, wanted: Member, now: datetime, days: float | None = None) -> IssuedCertificate:
    """Issue a new certificate in place of a member's last one, with a new key.

    Raises:
        PkiError: the member has none, or is revoked.

    """
    with changing(pki) as members:
        known = _known(pki, members, wanted)
        if known.revoked:
            raise PkiError(f"{pki / MEMBERS_FILE}: {wanted} is revoked, and gets no other certificate")
        return _issue(pki, members, wanted, now, known.days if days is None else days, tuple(known.hosts))


def ends_soon(known: IssuedCertificate, now: datetime) -> bool:
    """Whether a certificate has ended, or has less than a third of its life left."""
    return known.not_after - now < timedelta(days=known.days) * RENEW_BELOW


def renew_due(pki: Path, now: datetime) -> list[IssuedCertificate]:
    """Renew the certificates that end soon, except those of revoked members, for the same validity as before."""
    due = [one for one in read_members(pki / MEMBERS_FILE).members if not one.revoked and ends_soon(one, now)]
    return [renew(pki, one.member, now) for one in due]


def revoke(pki: Path, wanted: Member) -> IssuedCertificate:
    """Remove a member from the routers' rules for good.

    Zenoh has no list of revoked certificates: the holder of this one can connect until it ends, and do nothing. That of
    a router is different: members accept it until it ends.

    Raises:
        PkiError: the member has no certificate.

    """
    with changing(pki) as members:
        revoked = msgspec.structs.replace(_known(pki, members, wanted), revoked=True)
        _write_members(pki, members.having(revoked))
        return revoked


def _known(pki: Path, members: MembersFile, wanted: Member) -> IssuedCertificate:
    known = members.find(wanted)
    if known is None:
        names = ", ".join(str(one.member) for one in members.members) or "none"
        raise PkiError(f"{pki / MEMBERS_FILE}: {wanted} has no certificate; there are {names}")
    return known


def _issue(
    pki: Path, members: MembersFile, wanted: Member, now: datetime, days: float, hosts: tuple[str, ...]
) -> IssuedCertificate:
    if not 0 < days <= 3650:
        raise PkiError(f"--days: expected 0 < days ≤ 3650, got {days:g}")
    _need_cryptography(pki)
    from robrain.deploy.pki.authority import Authority

    if not (pki / CA_KEY).is_file():
        raise PkiError(f"{pki / CA_KEY}: no such file; certificates are issued where the CA's key is")
    check_private(pki / CA_KEY)
    ca_certificate = (pki / CA_CERTIFICATE).read_bytes()
    try:
        pair = Authority(ca_certificate, (pki / CA_KEY).read_bytes()).issue(wanted, days, now, hosts)
    except PkiError as error:
        raise PkiError(f"{pki / CA_KEY}: {error}") from error
    folder = folder_of(pki, wanted)
    make_folder(folder)
    # The key first: until the certificate is there too, the old one does not fit it, and a reader tries again.
    write_file(folder / KEY, pair.key)
    write_file(folder / CERTIFICATE, pair.certificate, PUBLIC)
    write_file(folder / CA, ca_certificate, PUBLIC)
    issued = IssuedCertificate(
        role=wanted.role,
        team=wanted.team,
        name=wanted.name,
        serial=f"{pair.serial:x}",
        not_after=pair.not_after,
        days=days,
        hosts=list(hosts),
    )
    _write_members(pki, members.having(issued))
    return issued


def _write_members(pki: Path, members: MembersFile) -> None:
    """The list of members, and its copies in the folders of routers."""
    text = msgspec.json.format(msgspec.json.encode(members))
    write_file(pki / MEMBERS_FILE, text)
    for one in members.members:
        folder = folder_of(pki, one.member)
        if one.member.role is MemberRole.ROUTER and not one.revoked and folder.is_dir():
            write_file(folder / MEMBERS_FILE, text)
            text_of_zenohd = zenohd_text(members.allowed, one.member, endpoints_of(folder / ZENOHD_FILE))
            write_file(folder / ZENOHD_FILE, text_of_zenohd.encode())


def _need_cryptography(where: Path) -> None:
    try:
        import cryptography  # noqa: F401
    except ImportError as error:
        missing = missing_package(error)
        needed = missing.needed if missing is not None else str(error)
        raise PkiError(f"{where}: certificates need another package: pip install '{needed}'") from error
