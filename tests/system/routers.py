"""Routers of a secured team as processes: `robrain router`, or `zenohd` where ROBRAIN_ZENOHD names its program."""

import os
import socket
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from robrain.deploy.pki.issuing import MEMBERS_FILE, ZENOHD_FILE, Endpoints, folder_of, read_members, zenohd_text
from robrain.protocol.access.identity import TLS_VARIABLE
from robrain.protocol.access.member import Member
from tests.system.conftest import Commands
from tests.waiting import until

ZENOHD = os.environ.get("ROBRAIN_ZENOHD", "")


class Router(NamedTuple):
    """One that runs."""

    process: "subprocess.Popen[str]"
    endpoint: str


def start_router(commands: Commands, pki: Path, router: Member, connect: Sequence[str] = (), at: str = "") -> Router:
    """Start a router and wait until it listens, at a free port unless told where."""
    endpoint = at or f"tls/127.0.0.1:{_free_port()}"
    folder = folder_of(pki, router)
    if not ZENOHD:
        words = ("router", "--listen", endpoint, *(("--connect", ",".join(connect)) if connect else ()))
        process: subprocess.Popen[str] = commands.start(*words, **{TLS_VARIABLE: str(folder)})
        Commands.line_with(process, "members may connect")
        return Router(process, endpoint)
    members = read_members(folder / MEMBERS_FILE).allowed
    (folder / ZENOHD_FILE).write_text(zenohd_text(members, router, Endpoints((endpoint,), tuple(connect))))
    process = subprocess.Popen(
        [ZENOHD, "-c", ZENOHD_FILE], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True
    )
    commands.adopt(process)
    until(lambda: _listens(endpoint), f"zenohd never listened at {endpoint}")
    return Router(process, endpoint)


def _listens(endpoint: str) -> bool:
    host, port = endpoint.removeprefix("tls/").split(":")
    with socket.socket() as probe:
        return probe.connect_ex((host, int(port))) == 0


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
