"""What a process checks before it joins a secured team, and how it tells what it lacks."""

from collections.abc import Callable, Sequence

import zenoh

from robrain.protocol.access.identity import Identity
from robrain.protocol.access.member import MemberRole
from robrain.protocol.errors import WireError
from robrain.protocol.wire.session import is_loopback, is_secured, own_identity
from robrain.protocol.wire.trial import missing_rights

Note = Callable[[str], None]


def warn_of_listening(who: str, listen: Sequence[str], note: Note) -> None:
    """Warn of endpoints without certificates that other machines can reach."""
    for endpoint in listen:
        if not is_secured(endpoint) and not is_loopback(endpoint):
            note(
                f"{who}: warning: other machines can reach {endpoint}, and there is no log-in: anyone there can drive, "
                "halt and resume the robots; `robrain router` asks for certificates"
            )


def check_certificate(
    who: str, note: Note, connect: Sequence[str], team: str, role: MemberRole, name: str | None = None
) -> Identity | None:
    """Check the certificate that a process is to show; None if its endpoints ask for none.

    Says when the certificate soon ends.

    Args:
        who: name of the process, for messages.
        note: prints a line.
        connect: the endpoints that it connects to.
        team: its team.
        role: what its certificate must be for.
        name: its name; None accepts any.

    Raises:
        WireError: there is no certificate, it cannot be used, or it is of another role, team or name.

    """
    if not any(map(is_secured, connect)):
        return None
    identity = own_identity(next(filter(is_secured, connect)))
    shown = identity.member
    wanted = f"{role}:{team}:{shown.name if name is None else name}"
    if shown.common_name != wanted:
        raise WireError(f"{identity.folder}: expected the certificate of {wanted}, got that of {shown.common_name}")
    warning = identity.warning()
    if warning:
        note(f"{who}: {warning}")
    return identity


def check_rights(who: str, note: Note, session: zenoh.Session, connect: Sequence[str], identity: Identity) -> None:
    """Try what the process needs, as the router drops in silence what it does not allow.

    Raises:
        WireError: the router allows nothing of it.

    """
    missing = missing_rights(session, connect, identity)
    if not missing:
        return
    where, shown = ", ".join(connect), identity.member.common_name
    text = f"the router at {where} does not let {shown} {', '.join(map(str, missing.denied))}"
    if missing.is_all:
        raise WireError(
            f"{text}: the certificate is revoked, or the router's members.json is older than the certificate"
        )
    note(f"{who}: warning: {text}: its rules are not those of this version of robrain")
