"""Checks of this machine's network: routers, ports, addresses."""

import errno
import socket
from collections.abc import Sequence
from contextlib import closing

from robrain.deploy.doctor.check import Check, CheckName
from robrain.protocol.errors import NobodyThere, PortTaken, WireError
from robrain.protocol.wire.session import check_port_free, may_answer, open_session


def check_router(endpoints: Sequence[str]) -> Check:
    """Whether a Zenoh router answers at one of the endpoints."""
    where = ", ".join(endpoints)
    if not any(map(may_answer, endpoints)):
        return Check(
            CheckName.ROUTER,
            False,
            f"nobody listens at {where}",
            "start `robrain up` or a Zenoh router there, and look at address, port and firewall; "
            "--connect or [zenoh] connect names another",
        )
    try:
        open_session(connect=endpoints).close()
    except (NobodyThere, WireError):
        return Check(
            CheckName.ROUTER,
            False,
            f"something listens at {where}, but admits no client: it is no Zenoh router, or refuses the certificate",
            "look at what listens there, and at the certificates of both",
        )
    return Check(CheckName.ROUTER, True, f"a router answers at {where}")


def check_port(what: str, endpoint: str) -> Check:
    """Whether a part can listen at an endpoint. A router that answers there is the part itself.

    Args:
        what: the part, for the sentence: `the hub`.
        endpoint: such as `tcp/127.0.0.1:7447`.

    """
    try:
        check_port_free(endpoint)
    except PortTaken:
        if check_router([endpoint]).ok:
            return Check(CheckName.PORT, True, f"{what} is at {endpoint} already")
        return Check(
            CheckName.PORT,
            False,
            f"{what} cannot listen at {endpoint}: the port is taken",
            "end the process that listens there (`ss -ltnp` names it), or choose another port",
        )
    except WireError as error:
        return Check(CheckName.PORT, False, f"{what} cannot listen: {error}", "choose an address of this machine")
    return Check(CheckName.PORT, True, f"{what} can listen at {endpoint}")


def check_address(host: str, address: str) -> Check:
    """Whether a host's address is one of this machine's, so that its parts are started on the right one."""
    try:
        infos = socket.getaddrinfo(address, 0, type=socket.SOCK_STREAM)
    except OSError as error:
        return Check(
            CheckName.ADDRESS, False, f"the address {address} of host {host} is unknown here: {error.strerror}",
            "give an IP address, or make the name known to this machine",
        )  # fmt: skip
    for family, kind, _, _, place in infos:
        with closing(socket.socket(family, kind)) as probe:
            try:
                probe.bind(place)
            except OSError as error:
                if error.errno != errno.EADDRNOTAVAIL:
                    return Check(CheckName.ADDRESS, None, f"the address {address} cannot be tried: {error.strerror}")
            else:
                return Check(CheckName.ADDRESS, True, f"this machine has the address {address} of host {host}")
    return Check(
        CheckName.ADDRESS, False, f"this machine does not have the address {address} of host {host}",
        f"run this on the machine of host {host}, or correct its address in the team file",
    )  # fmt: skip
