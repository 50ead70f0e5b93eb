"""A small secured team of real processes, and certificates for those who attack it."""

import json
import time
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import zenoh

from robrain.agent.authoring.skeleton import write_skeleton
from robrain.deploy.pki.issuing import folder_of, init, issue, revoke
from robrain.protocol.access.identity import TLS_VARIABLE, read_identity
from robrain.protocol.access.member import Member, member
from robrain.protocol.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import CONNECT_VARIABLE
from robrain.protocol.wire.session import open_session
from tests.system.conftest import Commands
from tests.system.routers import start_router

TEAM, OTHER_TEAM = "blue", "green"
MEMBERS = (
    "router site", "coordinator hq", "coordinator witness", "operator ann", "operator bob", "operator mallory",
    "viewer vic", "recorder rec", "dashboard hall", "robot r1", "robot r2", "arena sim",
)  # fmt: skip
OTHERS = ("operator eve", "robot g1", "coordinator hq")
REVOKED = "operator mallory"
ROBOT_FILE = '[robot]\nname = "r1"\nteam = "blue"\nplaces = ["plugins"]\nload = ["counter", "command", "tool"]\n'
EXCLUSIVE = "[tag]\nshared = false"
"""One at a time may hold the tool."""
SOON_S = 0.25
"""Time for what is sent through the router to arrive, where it must not."""
CONNECT_MS = 300


class SecuredTeam:
    """Router, coordinator and robot r1 as processes; robot r2 is a certificate alone."""

    def __init__(self, folder: Path) -> None:
        self.commands = Commands(folder)
        self.pki = folder / "pki"
        now = datetime.now(UTC)
        init(self.pki, TEAM, now)
        for team, names in ((TEAM, MEMBERS), (OTHER_TEAM, OTHERS)):
            for name in names:
                issue(self.pki, member_named(name, team), now)
        revoke(self.pki, member_named(REVOKED))
        (folder / "r1.toml").write_text(ROBOT_FILE)
        manifest = write_skeleton("tool", "device", folder / "plugins")[1]
        manifest.write_text(manifest.read_text().replace("[tag]", EXCLUSIVE))
        self._sessions: dict[Member, zenoh.Session] = {}
        self._wires: list[Endpoint] = []
        self.endpoint = start_router(self.commands, self.pki, member_named("router site")).endpoint
        self.coordinator = self._start("coordinator hq", "coordinator", "--team", TEAM)
        self.agent = self._start("robot r1", "agent", "r1.toml")
        Commands.line_with(self.coordinator, "of team")
        Commands.line_with(self.agent, "is up with")

    def folder_of(self, who: Member) -> Path:
        return folder_of(self.pki, who)

    def variables(self, name: str) -> dict[str, str]:
        """The environment of somebody's commands."""
        return {TLS_VARIABLE: str(self.folder_of(member_named(name))), CONNECT_VARIABLE: getattr(self, "endpoint", "")}

    def session(self, who: Member) -> zenoh.Session:
        """A raw session with somebody's certificate: what an attacker with his files opens."""
        if who not in self._sessions:
            identity = read_identity(self.folder_of(who))
            self._sessions[who] = open_session(connect=[self.endpoint], identity=identity)
        return self._sessions[who]

    def wire(self, name: str) -> Endpoint:
        """An endpoint of robrain with somebody's certificate."""
        wire = Endpoint(self.session(member_named(name)), TEAM, LiveClock(), Drive.LIVE)
        self._wires.append(wire)
        return wire

    def close(self) -> None:
        for wire in self._wires:
            wire.close()
        for session in self._sessions.values():
            session.close()
        self.commands.stop_all()

    def _start(self, name: str, *words: str) -> Any:
        return self.commands.start(*words, **self.variables(name))


def member_named(text: str, team: str = TEAM) -> Member:
    role, name = text.split()
    return member(role, team, name)


def open_raw(endpoint: str, tls: dict[str, Any] | None = None, connect_ms: int = CONNECT_MS) -> zenoh.Session | None:
    """Open a session with any TLS settings. Return None if the router does not accept it within *connect_ms*."""
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": connect_ms,
        "scouting/multicast/enabled": False,
        **({"transport/link/tls": tls} if tls is not None else {}),
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with suppress(zenoh.ZError):
        return zenoh.open(config)
    return None


def soon(is_so: Any) -> bool:
    """Whether it comes to pass within the time for what must not."""
    end_s = time.monotonic() + SOON_S
    while time.monotonic() < end_s:
        if is_so():
            return True
        time.sleep(0.01)
    return bool(is_so())


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredTeam]:
    found = SecuredTeam(tmp_path_factory.mktemp("secured"))
    yield found
    found.close()
