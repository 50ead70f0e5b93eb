"""`robrain up` leaves nothing behind, gives up what always fails, and runs on several machines; `top` and `doctor`."""

import json
import os
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest

from robrain import Team
from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S, has_ended, until

pytestmark = pytest.mark.system

TEAM_FILE = """
[team]
name = "blue"
scenario = "arena_small"
port = {port}

[[hosts]]
name = "base"
address = "{base}"
parts = ["hub", "arena", "coordinator", "r1"]

[[hosts]]
name = "cart"
address = "{cart}"
parts = ["r2"]
"""
SMALL = ("up", "arena_small", "--robots", "1", "--no-dashboard", "--json")
LEFT_S = 20.0
"""Far beyond the guard's grace of 3 s."""


def _port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def _parts(process: subprocess.Popen[str], names: set[str]) -> dict[str, int]:
    """Process ids by part, once all of these are up."""
    assert process.stdout is not None
    pids: dict[str, int] = {}
    while names:
        line = process.stdout.readline()
        assert line, f"{names} never came up"
        event = json.loads(line) if line.startswith("{") else {}
        if event.get("kind") == "started":
            pids[event["part"]] = event["pid"]
        elif event.get("kind") == "up":
            names = names - {event["part"]}
    return pids


def test_nothing_is_left_when_up_is_killed_even_of_a_process_that_stands_still(commands: Commands) -> None:
    process = commands.start(*SMALL, stderr=subprocess.DEVNULL)
    pids = _parts(process, {"hub", "coordinator"})
    os.kill(pids["coordinator"], signal.SIGSTOP)
    process.kill()
    process.wait()
    ends_s = time.monotonic() + LEFT_S
    until(lambda: all(map(has_ended, pids.values())) or time.monotonic() > ends_s)
    assert all(map(has_ended, pids.values()))


def test_two_hosts_of_a_team_file_are_one_team(commands: Commands) -> None:
    port = _port()
    Path(commands.folder / "team.toml").write_text(TEAM_FILE.format(port=port, base="127.0.0.3", cart="127.0.0.2"))
    cart = commands.start("up", "team.toml", "--host", "cart")  # before its hub is there
    base = commands.start("up", "team.toml", "--host", "base")
    commands.line_with(base, "r1: up")
    commands.line_with(cart, "r2: up")
    _is_one_team(f"tcp/127.0.0.3:{port}")
    cart.send_signal(signal.SIGINT)
    assert cart.wait(PATIENCE_S) == 0
    done = commands.run("up", "team.toml")
    assert done.returncode == 2
    assert "expected --host with one of base, cart" in done.stderr


def _is_one_team(endpoint: str) -> None:
    def robots() -> bool:
        with Team.connect(endpoint, team="blue", patience_s=PATIENCE_S) as team:
            return sorted(team.robots) == ["r1", "r2"]

    until(robots, "the two hosts are not one team", pause_s=0.2)
