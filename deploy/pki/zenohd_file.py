"""The configuration of `zenohd`, Zenoh's own router, that does as `robrain router` does."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from robrain.protocol.wire.access.identity import CA, CERTIFICATE, KEY
from robrain.protocol.wire.access.member import Member
from robrain.protocol.wire.access.rules import access_control
from robrain.protocol.wire.errors import WireError
from robrain.protocol.wire.session import LEASE_MS, check_endpoint

ZENOHD_FILE = "zenohd.json5"
ZENOHD_PORT = 7447


LISTEN = (f"tls/127.0.0.1:{ZENOHD_PORT}",)
"""This machine alone."""


def listening_of(path: Path) -> tuple[str, ...]:
    """The endpoints of a file written before, which the router's owner may have changed; `LISTEN` if they are lost."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        settings = json.loads("\n".join(line for line in lines if not line.lstrip().startswith("//")))
        return tuple(check_endpoint(one) for one in settings["listen"]["endpoints"]) or LISTEN
    except (OSError, ValueError, KeyError, TypeError, WireError):
        return LISTEN


def zenohd_text(members: Sequence[Member], listen: Sequence[str] = LISTEN) -> str:
    """The text of a file for `zenohd -c`, to be run in the router's folder: its paths are relative."""
    settings: dict[str, Any] = {
        "mode": "router",
        "listen": {"endpoints": list(listen)},
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
                },
            },
            "shared_memory": {"enabled": False},
        },
        "access_control": access_control(members),
    }
    return (
        "// Written by `robrain pki` with each change of the members; start zenohd in this folder.\n"
        "// To be reached from other machines, change listen.endpoints.\n" + json.dumps(settings, indent=1) + "\n"
    )
