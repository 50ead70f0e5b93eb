"""The configuration of `zenohd`, Zenoh's own router, that does as `robrain router` does."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from robrain.protocol.wire.access.identity import CA, CERTIFICATE, KEY
from robrain.protocol.wire.access.member import Member
from robrain.protocol.wire.access.rules import access_control
from robrain.protocol.wire.errors import WireError
from robrain.protocol.wire.session import LEASE_MS, check_endpoint

ZENOHD_FILE = "zenohd.json5"
ZENOHD_PORT = 7447


LISTEN = (f"tls/127.0.0.1:{ZENOHD_PORT}",)
"""This machine alone."""


class Endpoints(NamedTuple):
    """Where a router listens, and the other routers that it connects to."""

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
