"""Opening Zenoh sessions, with the settings that measurements recommend (docs/decisions/0002-sessions.md)."""

import errno
import ipaddress
import json
import os
import re
import socket
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import zenoh

from robrain.protocol.access.identity import TLS_VARIABLE, Connection, Identity, read_identity, remember, tls_folder
from robrain.protocol.access.member import MemberRole
from robrain.protocol.errors import NobodyThere, PortInUse, WireError

NO_SETTINGS: Mapping[str, Any] = MappingProxyType({})
LEASE_MS = 2000
"""A cut link is noticed after this; 800 ms did not flap on loopback, 2 s leaves room for busy machines."""

LISTENING_TIMEOUT_S = 60.0
"""A router answers for itself where it listens, at once unless the machine is paused."""

TCP_ENDPOINT = re.compile(r"tcp/(?P<host>\[[^\]]+\]|[^:/]+):(?P<port>\d+)")
"""A plain TCP endpoint: host and port."""
PROBE_TIMEOUT_S = 0.5
LISTENING = re.compile(TCP_ENDPOINT.pattern.replace("tcp", "(tcp|tls)"))
"""As above, or with certificates."""
_ADDRESS = re.compile(r"(tcp|tls|udp)/(?P<host>\[[^\]]+\]|[^:/?#]+)(:(?P<port>\d{1,9}))?")
MAX_PORT = 65535
_ENDPOINT = re.compile(r"(tcp|tls|quic|udp|unixsock-stream|ws)/.+")


def open_lockstep_session(listen: str | None = None) -> zenoh.Session:
    """A session that keeps to itself: no scouting, no network unless `listen` (loopback) is given.

    Raises:
        PortInUse: another process listens there.
    """
    settings: dict[str, Any] = {"scouting/multicast/enabled": False, "scouting/gossip/enabled": False}
    if listen is None:
        settings |= {"mode": "peer", "listen/endpoints": []}
        return _open(settings, what="a lockstep session")
    return open_session(mode="router", listen=(listen,))


def open_session(
    *,
    mode: str = "client",
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    wait_s: float = 3.0,
    identity: Identity | None = None,
    more: Mapping[str, Any] = NO_SETTINGS,
) -> zenoh.Session:
    """A session of the live drive.

    A client that connects to `tls/…` shows a certificate, and its endpoints then use the name in it.

    Args:
        mode: `client` (of a router), `peer` (finds others by multicast when it has no endpoints) or `router`.
        connect: endpoints to connect to, such as `tcp/127.0.0.1:7447`.
        listen: endpoints to listen on.
        wait_s: how long to try to connect; negative waits for ever.
        identity: the certificate for `tls/…`; None reads the folder that ROBRAIN_TLS names.
        more: further settings of Zenoh, such as the access rules of a secured router.

    Raises:
        NobodyThere: nothing answers at `connect`.
        PortInUse: another process listens at `listen`.
        WireError: an endpoint is not one, or Zenoh refuses for another reason.
    """
    for endpoint in (*connect, *listen):
        check_endpoint(endpoint)
    for endpoint in listen:
        check_port_free(endpoint)
    if identity is None and any(map(is_secured, (*connect, *listen))):
        secured = next(filter(is_secured, (*connect, *listen)))
        if mode != "client":  # it would have no rules
            raise WireError(f"{secured}: expected tcp/HOST:PORT: only `robrain router` listens on tls/")
        identity = own_identity(secured)
    folder = tls_folder()
    if identity is None and folder is not None and mode != "router":
        raise WireError(
            f"{', '.join((*connect, *listen)) or f'a {mode} without endpoints'}: expected tls/HOST:PORT, since a "
            f"certificate is to be shown ({folder}, from --tls, {TLS_VARIABLE} or [zenoh.tls])"
        )
    if identity is not None:
        _check_secured(mode, (*connect, *listen), identity)
    settings: dict[str, Any] = {
        "mode": mode,
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1 if wait_s < 0 else round(wait_s * 1000),
        "connect/exit_on_failure": True,
        "connect/retry": {
            "period_init_ms": 200,
            "period_max_ms": 1000,
            "period_increase_factor": 1.5,
        },
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": mode == "peer" and not connect and not listen,
        "scouting/gossip/enabled": mode == "peer",
        **({"scouting/delay": 0} if mode == "router" and not connect else {}),  # half a second without a benefit
        "transport/link/tx/lease": LEASE_MS,
        "transport/shared_memory/enabled": False,
        "adminspace/enabled": mode == "router",
        "timestamping/enabled": True,
        **(identity.settings() if identity is not None else {}),
        **more,
    }
    if mode == "client" and not connect:
        raise WireError(
            "no endpoint to connect to: give --connect tcp/HOST:PORT or set ROBRAIN_CONNECT "
            "(`robrain up` prints the endpoint it listens on)"
        )
    try:
        session = _open(settings, what=f"a {mode} session")
        if identity is not None:
            remember(session, Connection(identity, tuple(connect)))
    except WireError as error:
        for endpoint in listen:  # another process may have taken the port meanwhile
            check_port_free(endpoint)
        if connect and identity is not None:
            raise NobodyThere(
                f"nobody answers {identity.member} at {', '.join(connect)}: is `robrain router` running there, and are "
                "both certificates of one CA and in time?"
            ) from error
        if any(TCP_ENDPOINT.fullmatch(each) and may_answer(each) for each in connect):
            raise NobodyThere(
                f"what listens at {', '.join(connect)} does not answer in plain Zenoh: a secured team is reached by "
                "`robrain --tls FOLDER COMMAND --connect tls/HOST:PORT`, as `robrain up` prints it"
            ) from error
        if connect:
            raise NobodyThere(
                f"nobody answers at {', '.join(connect)}: is `robrain up` or a Zenoh router running there?"
            ) from error
        raise
    return session


def may_answer(endpoint: str) -> bool:
    """Whether something accepts connections there; True for endpoints other than TCP, which only Zenoh can try."""
    match = TCP_ENDPOINT.fullmatch(endpoint)
    if match is None:
        return True
    try:
        with socket.create_connection((match["host"].strip("[]"), int(match["port"])), PROBE_TIMEOUT_S):
            return True
    except (OSError, OverflowError):
        return False


def check_endpoint(endpoint: str) -> str:
    """Return `endpoint` if it has the form of one, else raise WireError that shows the form."""
    if not _ENDPOINT.fullmatch(endpoint):
        raise WireError(f"{endpoint!r} is not an endpoint: expected something like tcp/127.0.0.1:7447")
    if address := _ADDRESS.match(endpoint):
        if address["port"] is None:
            raise WireError(f"{endpoint!r} has no port: expected something like tcp/127.0.0.1:7447")
        if int(address["port"]) > MAX_PORT:
            raise WireError(f"{endpoint!r}: expected a port from 0 to {MAX_PORT}")
    return endpoint


def unknown_host(endpoint: str) -> str:
    """The host of an endpoint if no name server knows it; empty if it is known or the endpoint has none."""
    address = _ADDRESS.match(endpoint)
    if address is None:
        return ""
    host = address["host"].strip("[]")
    try:
        socket.getaddrinfo(host, None)
    except OSError:
        return host
    return ""


def is_secured(endpoint: str) -> bool:
    """Whether both ends of an endpoint show certificates."""
    return endpoint.startswith("tls/")


def own_identity(endpoint: str) -> Identity:
    """The certificate in the folder that ROBRAIN_TLS names.

    Raises:
        WireError: it names none, or its certificate cannot be used.

    """
    folder = tls_folder()
    if folder is None:
        raise WireError(
            f"{endpoint} asks for a certificate: give `robrain --tls FOLDER …` or set {TLS_VARIABLE} "
            "(`robrain pki issue` makes such a folder)"
        )
    return read_identity(folder)


def _check_secured(mode: str, endpoints: Sequence[str], identity: Identity) -> None:
    """A secured session goes by certificates alone: peers would go round the router's rules."""
    wanted = "router" if identity.member.role is MemberRole.ROUTER else "client"
    if mode != wanted:
        raise WireError(
            f"{identity.folder}: the certificate of {identity.member} is for a {wanted}, and this is a {mode}: secured "
            "members connect to `robrain router`"
        )
    plain = [endpoint for endpoint in endpoints if not is_secured(endpoint)]
    if plain:
        raise WireError(f"{', '.join(plain)}: expected tls/HOST:PORT beside a certificate ({identity.folder})")


def is_loopback(endpoint: str) -> bool:
    """Whether a listening endpoint can be reached from this machine only."""
    match = LISTENING.fullmatch(endpoint)
    if match is None:
        return False
    host = match["host"].strip("[]")
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:  # a host name: its address is unknown
        return False


def listening_at(session: zenoh.Session) -> list[str]:
    """The endpoints at which a router session listens, with the actual port if port 0 was requested."""
    zid = session.zid()
    for reply in session.get(f"@/{zid}/router", timeout=LISTENING_TIMEOUT_S):
        if reply.ok is not None:
            status = json.loads(reply.ok.payload.to_bytes())
            return sorted(locator for locator in status.get("locators", []) if isinstance(locator, str))
    return []


def check_port_free(endpoint: str) -> None:
    """Check that a TCP endpoint can be listened on; other endpoints pass.

    Raises:
        PortInUse: another process listens there.
        WireError: it cannot be listened on for another reason.

    """
    match = LISTENING.fullmatch(endpoint)
    if match is None or match["port"] == "0":
        return
    host = match["host"].strip("[]")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, int(match["port"])))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise PortInUse(
                    f"port taken: another process listens on {endpoint}; give another, or port 0 for a free one"
                ) from error
            raise WireError(f"cannot listen on {endpoint}: {error.strerror}") from error
        except OverflowError as error:
            raise WireError(f"cannot listen on {endpoint}: expected a port from 0 to 65535") from error


_users: set[int] = set()
"""Processes that opened a session: this one, and those that it was forked from."""


def _open(settings: dict[str, Any], *, what: str) -> zenoh.Session:
    if _users - {os.getpid()}:  # Zenoh's threads are not in a forked process: opening or closing would never end
        raise WireError(
            f"cannot open {what}: this process was forked from one that has used Zenoh; start it with the method "
            "`spawn` or `forkserver` of multiprocessing"
        )
    _users.add(os.getpid())
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise WireError(f"cannot open {what}: {str(error).splitlines()[0]}") from error
