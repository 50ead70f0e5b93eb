"""Checks of certificates: whether a process has the one that it is to show."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from robrain.deploy.doctor.check import Check, CheckName
from robrain.protocol.wire.access.identity import TLS_VARIABLE, read_identity
from robrain.protocol.wire.access.member import Member
from robrain.protocol.wire.errors import WireError
from robrain.protocol.wire.session import is_secured


class OwnCertificate(NamedTuple):
    """What a process is to show."""

    member: Member | None
    """Whose certificate; None accepts that of any member."""
    folder: Path | None
    """As `robrain pki issue` made it; None if none is given."""


def check_certificates(
    wanted: Sequence[OwnCertificate], endpoints: Sequence[str], now: datetime | None = None
) -> list[Check]:
    """A check for each certificate; none if no endpoint asks for one."""
    if not any(map(is_secured, endpoints)):
        return []
    return [check_certificate(one, now or datetime.now(UTC)) for one in wanted]


def check_certificate(wanted: OwnCertificate, now: datetime) -> Check:
    """Whether a certificate is there, can be read by its owner alone, is valid, and is the one that is wanted."""
    member, folder = wanted
    issue = f"`robrain pki issue {member.role} {member.name}`" if member else "`robrain pki issue`"
    if folder is None:
        return Check(
            CheckName.CERTIFICATE,
            False,
            "the router asks for a certificate, and none is given",
            f"give `robrain --tls FOLDER`, {TLS_VARIABLE} or folder in [zenoh.tls]; {issue} makes such a folder",
        )
    try:
        shown = read_identity(folder, now)
    except WireError as error:
        return Check(
            CheckName.CERTIFICATE, False, str(error), f"copy the folder that {issue} or `robrain pki renew` made"
        )
    if member is not None and shown.member != member:
        return Check(
            CheckName.CERTIFICATE,
            False,
            f"{folder}: expected the certificate of {member.common_name}, got that of {shown.member.common_name}",
            f"copy the folder that {issue} made",
        )
    warning = shown.warning(now)
    return Check(
        CheckName.CERTIFICATE,
        True,
        warning or f"{folder} has the certificate of {shown.member.common_name}",
        "copy the renewed folder over it; the next connection uses it" if warning else "",
    )
