"""`robrain up --secured`: every part shows a certificate, and nobody without one gets in."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from robrain.protocol.access.identity import TLS_VARIABLE
from robrain.protocol.wire.hub import CONNECT_VARIABLE
from tests.system.attacks.secured_team import open_raw
from tests.system.conftest import Commands

pytestmark = pytest.mark.system

SMALL = ("up", "arena_small", "--robots", "1", "--no-dashboard", "--json")


def hub_of(commands: Commands, process: "subprocess.Popen[str]") -> dict[str, Any]:
    found: dict[str, Any] = json.loads(commands.line_with(process, '"event":"hub"'))
    return found


def operator(hub: dict[str, Any]) -> dict[str, str]:
    return {TLS_VARIABLE: hub["tls"], CONNECT_VARIABLE: hub["endpoint"]}


def test_operators_commands_reach_the_team_and_who_has_no_certificate_does_not(commands: Commands) -> None:
    process = commands.start(*SMALL, "--secured", stderr=subprocess.DEVNULL)
    hub = hub_of(commands, process)
    assert hub["endpoint"].startswith("tls/127.0.0.1:")
    commands.line_with(process, '"part":"r1","kind":"up"')
    commands.run_until(lambda done: "r1" in done.stdout, "status", **operator(hub))
    halted = commands.run_until(lambda done: done.returncode == 0, "halt", **operator(hub))
    assert "1 of 1 robots" in halted.stdout
    assert open_raw(hub["endpoint"]) is None
    assert "asks for a certificate" in commands.refused("status", "--connect", hub["endpoint"])
    assert Path(hub["tls"]).is_dir()
    process.terminate()
    process.wait(60)
    assert not Path(hub["tls"]).exists(), "certificates that were made for the run alone are left"


def test_a_plain_endpoint_is_no_place_for_a_secured_team(commands: Commands) -> None:
    line = commands.refused(*SMALL[:-1], "--secured", "--listen", "tcp/127.0.0.1:0")
    assert line == "robrain: --listen tcp/127.0.0.1:0: expected tls/HOST:PORT for a secured team"
