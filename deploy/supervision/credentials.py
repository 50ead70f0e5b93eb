"""Certificates of the parts of a secured team: the certificate of each part, and creation of missing ones."""

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from robrain.deploy.errors import PkiError
from robrain.deploy.pki.issuing import (
    CA_KEY,
    MEMBERS_FILE,
    MEMBERS_FOLDER,
    ends_soon,
    folder_of,
    init,
    issue,
    read_members,
    renew,
)
from robrain.deploy.supervision.part import ARENA, COORDINATOR, DASHBOARD, HUB, RECORDER, STAND_BY, Part
from robrain.protocol.access.identity import CERTIFICATE, TLS_VARIABLE, read_identity
from robrain.protocol.access.member import Member, MemberRole, member

NAMES = {
    HUB: (MemberRole.ROUTER, "site"),
    ARENA: (MemberRole.ARENA, "sim"),
    COORDINATOR: (MemberRole.COORDINATOR, "hq"),
    STAND_BY: (MemberRole.COORDINATOR, "standby"),
    RECORDER: (MemberRole.RECORDER, "recorder"),
    DASHBOARD: (MemberRole.DASHBOARD, "page"),
}
"""Role and name of each stock part; a robot has its own name."""
OPERATOR = "up"
"""Name of the operator whose certificate `robrain up` presents, and whose commands it prints."""


class Credentials:
    """The certificates of a team's parts, in a folder of `robrain pki`.

    Args:
        pki: the folder. With the CA's key in it, certificates that are missing or soon end are made there. Without the
            key, the folder must hold them, as `robrain pki issue` has made them on another machine.
        team: the team.

    """

    def __init__(self, pki: Path, team: str) -> None:
        self.pki, self.team = pki, team

    def prepare(self, parts: Iterable[str], now: datetime, hosts: Sequence[str] = ()) -> None:
        """Make missing certificates of these parts and the operator.

        Args:
            parts: names of stock parts and robots.
            now: the time.
            hosts: further addresses at which the router is reached.

        Raises:
            PkiError: the folder is another team's, or a certificate cannot be made, or is not there.

        """
        if (self.pki / MEMBERS_FILE).is_file() and (team := read_members(self.pki / MEMBERS_FILE).team) != self.team:
            raise PkiError(f"{self.pki}: the certificates are of team {team}, not {self.team}; give --team {team}")
        has_none = not (self.pki / MEMBERS_FILE).exists() and not self.pki.joinpath(MEMBERS_FOLDER).is_dir()
        if has_none and HUB in parts:  # elsewhere a CA would be another one than the router's
            init(self.pki, self.team, now)
        wanted = [self.member(part) for part in parts] + [member(MemberRole.OPERATOR, self.team, OPERATOR)]
        if not (self.pki / CA_KEY).is_file():
            self._check_there(wanted)
            return
        if HUB in parts:
            # First the parts that connect, so that the router's rules are written once with all of them.
            wanted.sort(key=lambda one: one.role is MemberRole.ROUTER)
        for one in wanted:
            self._make(one, now, hosts if one.role is MemberRole.ROUTER else ())

    def renew(self, parts: Iterable[str], now: datetime) -> list[str]:
        """Renew certificates that soon end, if the CA's key is here; returns the names. Revoked members are skipped."""
        if not (self.pki / CA_KEY).is_file():
            return []
        wanted = [self.member(part) for part in parts] + [member(MemberRole.OPERATOR, self.team, OPERATOR)]
        members = read_members(self.pki / MEMBERS_FILE)
        due = [one for one in wanted if (known := members.find(one)) and not known.revoked and ends_soon(known, now)]
        for one in due:
            renew(self.pki, one, now)
        return [str(one) for one in due]

    def member(self, part: str) -> Member:
        """Member of the certificate that a part presents."""
        role, name = NAMES.get(part, (MemberRole.ROBOT, part))
        return member(role, self.team, name)

    def folder(self, part: str) -> Path:
        """The folder of a part's certificate."""
        return self._folder_of(self.member(part))

    @property
    def operator(self) -> Path:
        """The folder of the operator's certificate."""
        return self._folder_of(member(MemberRole.OPERATOR, self.team, OPERATOR))

    def shown_by(self, part: Part) -> Part:
        """The part, started with its certificate."""
        words = ["--tls", str(self.folder(part.name))]
        return part._replace(arguments=lambda start: [*words, *part.arguments(start)])

    @contextmanager
    def as_operator(self) -> Iterator[None]:
        """Present the operator's certificate in sessions that this process opens meanwhile."""
        before = os.environ.get(TLS_VARIABLE)
        os.environ[TLS_VARIABLE] = str(self.operator)
        try:
            yield
        finally:
            if before is None:
                del os.environ[TLS_VARIABLE]
            else:
                os.environ[TLS_VARIABLE] = before

    def _folder_of(self, wanted: Member) -> Path:
        if (self.pki / MEMBERS_FILE).is_file():
            return folder_of(self.pki, wanted)
        return self.pki / MEMBERS_FOLDER / f"{wanted.role}.{wanted.name}"

    def _make(self, wanted: Member, now: datetime, hosts: Sequence[str]) -> None:
        known = read_members(self.pki / MEMBERS_FILE).find(wanted)
        if known is None:
            issue(self.pki, wanted, now, hosts=hosts)
        elif known.revoked or ends_soon(known, now):  # a revoked one is refused there, in words
            renew(self.pki, wanted, now)
        else:
            read_identity(self._folder_of(wanted), now)

    def _check_there(self, wanted: Iterable[Member]) -> None:
        for one in wanted:
            folder = self._folder_of(one)
            if not (folder / CERTIFICATE).is_file():
                raise PkiError(
                    f"{folder / CERTIFICATE}: no such file, and no {CA_KEY} in {self.pki} to make it: "
                    f"`robrain pki issue {one.role} {one.name}` on the machine of the CA, then copy the folder here"
                )
