"""The folder of a team's certificates: its CA, its members, and a folder for each of them to take away.

pki/                    0700
    ca.pem              the CA's certificate
    ca.key              its key, 0600: its holder can issue certificates
    members.json        members with a certificate, and revoked members
    members/robot.r1/   for one member: ca.pem, certificate.pem, key.pem (0600); for a router also members.json and
                        zenohd.json5
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.access.member import Member, member
from robrain.protocol.errors import BadName, RobrainError


class PkiError(RobrainError):
    """A certificate, or a file of them, cannot be made or used."""


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


def write_private(path: Path, data: bytes) -> None:
    """Write a file that only its owner can read, in one step: a reader sees the old or the new one."""
    _write(path, data, PRIVATE)


def write_public(path: Path, data: bytes) -> None:
    """Write a file that others may read, in one step."""
    _write(path, data, PUBLIC)


def make_folder(path: Path) -> None:
    """Make a folder that only its owner can enter."""
    path.mkdir(mode=FOLDER, parents=True, exist_ok=True)
    path.chmod(FOLDER)


def _write(path: Path, data: bytes, mode: int) -> None:
    new = path.with_name(f".{path.name}.new")
    new.unlink(missing_ok=True)
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    new.chmod(mode)
    new.replace(path)
