"""`robrain router`: a Zenoh router that gives each certificate the permissions of its role, and no others."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import zenoh

from robrain.deploy.command_line.output import print_message, print_result
from robrain.deploy.errors import PkiError
from robrain.deploy.pki.issuing import MEMBERS_FILE, read_members
from robrain.deploy.processes.live_process import LiveStop
from robrain.protocol.access.identity import CERTIFICATE, Identity, check_private, read_identity, tls_folder
from robrain.protocol.access.member import MemberRole
from robrain.protocol.access.rules import access_control
from robrain.protocol.clock import steps
from robrain.protocol.errors import RobrainError
from robrain.protocol.wire.session import check_endpoint, is_loopback, is_secured, listening_at, open_session

DEFAULT_LISTEN = "tls/127.0.0.1:7447"
ROUTER_READY = "router: at "
RETRY = {"connect/timeout_ms": -1, "connect/exit_on_failure": False}
"""Another router may come later than this one, or go and come back."""
CHECK_S = 0.2
WATCHED = (MEMBERS_FILE, CERTIFICATE)
"""Files of its folder; if one changes, the router opens its session again."""


class SecuredRouter:
    """A router session with the rules of a folder.

    Args:
        folder: the router's, made by `robrain pki issue router NAME`.
        listen: endpoint, `tls/HOST:PORT`.
        connect: endpoints of other routers of the same CA; missing ones are tried again and again.

    Raises:
        PkiError: the folder is not a router's, or an endpoint is a plain one.
        WireError: the certificate cannot be used, or the endpoint not be listened on.

    """

    def __init__(self, folder: Path, listen: str = DEFAULT_LISTEN, connect: Sequence[str] = ()) -> None:
        for option, endpoint in (("--listen", listen), *(("--connect", one) for one in connect)):
            if not is_secured(check_endpoint(endpoint)):
                raise PkiError(f"{option} {endpoint}: expected tls/HOST:PORT")
        self.folder = folder
        self.listen = listen
        self.connect = tuple(connect)
        self._stamps = self._files()  # before they are read: later changes are read again
        identity, self._rules = self._settings()
        self._is_open = False
        self.session = self._open(identity)

    @property
    def endpoint(self) -> str:
        """Its endpoints."""
        return next(filter(is_secured, listening_at(self.session)))

    def update(self) -> str:
        """Open the session again if the folder's files have changed; members then connect again by themselves.

        Returns: The event, in words; empty if there is none.

        """
        stamps = self._files()
        if stamps == self._stamps and self._is_open:
            return ""
        try:  # first: if the files are invalid, or written in part, the router continues with its current rules
            identity, rules = self._settings()
        except RobrainError as error:
            return f"{error}; the router goes on with what it has"
        is_same = rules == self._rules and stamps.get(CERTIFICATE) == self._stamps.get(CERTIFICATE)
        self._stamps, self._rules = stamps, rules
        if self._is_open:
            if is_same:  # as after a renewal: no connection is to be closed for it
                return ""
            self.listen = self.endpoint
            self.session.close()
            self._is_open = False
        try:
            self.session = self._open(identity)
        except RobrainError as error:
            return f"{error}; the router tries again"
        return f"members and certificate are read again: {self.members} may connect"

    def close(self) -> None:
        """End it."""
        if self._is_open:
            self.session.close()

    def _open(self, identity: Identity) -> zenoh.Session:
        more = {"access_control": self._rules, **RETRY}
        connect = self.connect
        session = open_session(mode="router", connect=connect, listen=[self.listen], identity=identity, more=more)
        self._is_open = True
        return session

    def _settings(self) -> tuple[Identity, dict[str, object]]:
        identity = read_identity(self.folder)
        if identity.member.role is not MemberRole.ROUTER:
            raise PkiError(
                f"{self.folder / CERTIFICATE}: expected the certificate of a router, got {identity.member}'s"
            )
        check_private(self.folder / MEMBERS_FILE)  # this file sets everyone's permissions
        allowed = read_members(self.folder / MEMBERS_FILE).allowed
        self.members = sum(one.role is not MemberRole.ROUTER for one in allowed)
        return identity, access_control(allowed, identity.member)

    def _files(self) -> dict[str, tuple[int, int]]:
        found = {}
        for name in WATCHED:
            with suppress(OSError):
                status = (self.folder / name).stat()
                found[name] = status.st_mtime_ns, status.st_ino
        return found


def router_command(folder: Path | None, listen: str | None, connect: Sequence[str] = ()) -> None:
    """Run a router until Ctrl-C.

    Args:
        folder: the router's; None uses that of `--tls` or ROBRAIN_TLS.
        listen: endpoint; None listens on loopback alone.
        connect: endpoints of other routers.

    Raises:
        RobrainError: in one sentence.

    """
    folder = folder or tls_folder()
    if folder is None:
        raise PkiError("give the router's folder: `robrain --tls pki/members/router.NAME router`")
    should_stop = LiveStop()
    router = SecuredRouter(folder, listen or DEFAULT_LISTEN, connect)
    reported = ""
    try:
        if listen and not is_loopback(listen):
            print_message(f"router: other machines can reach {listen}; they need a certificate of this CA")
        others = f"joined to {', '.join(connect)}, " if connect else ""
        print_result(f"{ROUTER_READY}{router.endpoint}, {others}{router.members} members may connect; Ctrl-C ends it")
        should_stop.ready()
        for _ in steps(should_stop, CHECK_S):
            reported = _log_once(reported, router.update(), print_message)
    finally:
        router.close()


def _log_once(before: str, text: str, print_text: Callable[[str], None]) -> str:
    if text and text != before:
        print_text(f"router: {text}")
    return text
