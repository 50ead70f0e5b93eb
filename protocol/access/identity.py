"""The certificate of a process: its files, the name in it, and its end.

A folder made by `robrain pki issue` has `ca.pem`, `certificate.pem` and `key.pem`. Zenoh reads them again with each
connection, so files that are renewed in place need no restart.
"""

import os
import stat
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from robrain.protocol.access.member import Member, MemberRole, member_of
from robrain.protocol.errors import WireError
from robrain.protocol.extras import missing_package

TLS_VARIABLE = "ROBRAIN_TLS"
"""Environment variable with the folder of the process's certificate."""
CA, CERTIFICATE, KEY = "ca.pem", "certificate.pem", "key.pem"
PUBLIC_BITS = stat.S_IRWXG | stat.S_IRWXO
RENEW_BELOW = 1 / 3
"""Part of its life that a certificate has left when it is time to renew it."""
HOUR_S = 3600.0
IDENTITIES_MAX = 1024
"""Sessions of one process whose members are cached."""
_OF_SESSION: "dict[str, Connection]" = {}


class Identity(NamedTuple):
    """A certificate with its key, checked."""

    folder: Path
    member: Member
    not_before: datetime
    not_after: datetime

    def warning(self, now: datetime | None = None) -> str:
        """Warning about its remaining time; empty if there is enough.

        It is renewed when a third of its life is left.
        """
        left = self.not_after - (now or datetime.now(UTC))
        if left >= (self.not_after - self.not_before) * RENEW_BELOW:
            return ""
        return (
            f"the certificate of {self.member} ends in {duration(left.total_seconds())} "
            f"({self.folder / CERTIFICATE}): `robrain pki renew` makes another"
        )

    def settings(self) -> dict[str, Any]:
        """Zenoh's settings for connections that show this certificate; a router also listens with it."""
        certificate, key = str(self.folder / CERTIFICATE), str(self.folder / KEY)
        both = {"root_ca_certificate": str(self.folder / CA), "enable_mtls": True, "close_link_on_expiration": True}
        if self.member.role is MemberRole.ROUTER:
            both |= {"listen_certificate": certificate, "listen_private_key": key}
        own = {"connect_certificate": certificate, "connect_private_key": key, "verify_name_on_connect": True}
        return {"transport/link/tls": both | own}


def tls_folder() -> Path | None:
    """The folder that ROBRAIN_TLS names, if it is set."""
    text = os.environ.get(TLS_VARIABLE, "")
    return Path(text).expanduser() if text else None


def read_identity(folder: Path, now: datetime | None = None) -> Identity:
    """Read and check a certificate and its files.

    Raises:
        WireError: a file is missing or can be read by others. Also if the certificate has another name, is
            not valid yet or no longer, or does not match this CA or this key. The text names the file.

    """
    for name in (CA, CERTIFICATE, KEY):
        if not (folder / name).is_file():
            raise WireError(f"{folder / name}: no such file; expected a folder made by `robrain pki issue`")
    check_private(folder / KEY)
    where = folder / CERTIFICATE
    own, issuer, key = _load(where), _load(folder / CA), _load_key(folder / KEY)
    names = [str(one.value) for one in own.subject if one.rfc4514_attribute_name == "CN"]
    found = member_of(names[0]) if len(names) == 1 else None
    if found is None:
        raise WireError(f"{where}: expected the common name ROLE:TEAM:NAME, got {', '.join(names) or 'none'}")
    now = now or datetime.now(UTC)
    if now >= own.not_valid_after_utc:
        ago = duration((now - own.not_valid_after_utc).total_seconds())
        raise WireError(f"{where}: the certificate of {found} ended {ago} ago: `robrain pki renew` makes another")
    if now < own.not_valid_before_utc:
        early = duration((own.not_valid_before_utc - now).total_seconds())
        raise WireError(f"{where}: the certificate of {found} begins in {early}: is this machine's clock right?")
    try:
        own.verify_directly_issued_by(issuer)
    except Exception as error:  # by any of cryptography's classes: not signed by it
        raise WireError(f"{where}: the CA in {folder / CA} did not sign the certificate of {found}") from error
    if own.public_key() != key.public_key():
        raise WireError(f"{folder / KEY}: expected the key of {where}, got another")
    return Identity(folder, found, own.not_valid_before_utc, own.not_valid_after_utc)


def check_private(path: Path) -> None:
    """Check that only its owner can read a file.

    Raises:
        WireError: others can.

    """
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & PUBLIC_BITS:
        raise WireError(f"{path}: expected mode 0600, got {mode:04o}: other users can read the key; chmod 600 it")


def duration(seconds: float) -> str:
    """A time span in words.

    >>> duration(90_000), duration(7200), duration(90)
    ('25 hours', '2 hours', '90 s')
    """
    if seconds < HOUR_S:
        return f"{seconds:.0f} s"
    hours = round(seconds / HOUR_S)
    return f"{hours} hours" if hours < 72 else f"{hours // 24} days"


class Connection(NamedTuple):
    """How a secured session connects."""

    identity: Identity
    connect: tuple[str, ...]
    """Endpoints of routers."""


def remember(session: zenoh.Session, connection: Connection) -> None:
    """Record the member as which a session connects."""
    if len(_OF_SESSION) >= IDENTITIES_MAX:
        del _OF_SESSION[next(iter(_OF_SESSION))]  # the oldest
    _OF_SESSION[str(session.zid())] = connection


def connection_of(session: zenoh.Session) -> Connection | None:
    """How a session connects; None if it is not secured."""
    return _OF_SESSION.get(str(session.zid())) if _OF_SESSION else None


def member_on(session: zenoh.Session) -> Member | None:
    """Member as which a session connects; None if it is not secured."""
    connection = connection_of(session)
    return None if connection is None else connection.identity.member


def _load(path: Path) -> Any:
    x509 = _cryptography(path).x509
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except (ValueError, OSError) as error:
        raise WireError(f"{path}: expected a certificate in PEM, got something else") from error


def _load_key(path: Path) -> Any:
    _cryptography(path)
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        return load_pem_private_key(path.read_bytes(), None)
    except (ValueError, TypeError, OSError) as error:
        raise WireError(f"{path}: expected a private key in PEM without a password, got something else") from error


def _cryptography(path: Path) -> Any:
    try:
        import cryptography.x509
    except ImportError as error:
        missing = missing_package(error)
        needed = missing.needed if missing is not None else str(error)
        raise WireError(f"{path}: certificates need another package: pip install '{needed}'") from error
    return cryptography
