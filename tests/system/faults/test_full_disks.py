"""Full disks under journal and recording, and a page that hangs: robots work on, and operators are told."""

import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from robrain import Team
from robrain.coordinator.journal.journal import Journal
from robrain.protocol.wire.errors import CallError
from tests.system.conftest import Commands
from tests.system.hanging import unread_socket
from tests.waiting import until

pytestmark = pytest.mark.system
SIZE = "8m"
IN_A_SMALL_ROOM = """
mount -t tmpfs -o size={size} tmpfs {disk} || exit 77
{command} &
process=$!
trap 'kill -INT $process' TERM
while kill -0 $process 2>/dev/null; do wait $process; done
"""
WATCHED_S = 2.0
SLOWED = 1.5


class SmallDisk:
    """A process whose files are on a disk of its own, which is filled at will."""

    def __init__(self, commands: Commands, name: str, words: list[str]) -> None:
        disk = commands.folder / name
        disk.mkdir()
        command = shlex.join([sys.executable, "-m", "robrain.cli", *(word.format(disk=disk) for word in words)])
        script = IN_A_SMALL_ROOM.format(size=SIZE, disk=shlex.quote(str(disk)), command=command)
        self.process = subprocess.Popen(
            ["unshare", "-Urm", "bash", "-c", script], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        commands.adopt(self.process)
        self.folder = Path(f"/proc/{self.process.pid}/root") / disk.relative_to("/")

    @contextmanager
    def full(self) -> Iterator[None]:
        """Filled to the last byte for as long as the block lasts."""
        ballast = self.folder / "ballast"
        with suppress(OSError), ballast.open("wb", buffering=0) as stream:
            while True:
                stream.write(bytes(4096))
        yield
        ballast.unlink()


def period_s(client: Team) -> float:
    """90th percentile of the time between the stamps of a robot's states."""
    stamps_ns: list[int] = []
    end_s = time.monotonic() + WATCHED_S
    while time.monotonic() < end_s:
        stamp_ns = client.state("r1").stamp_ns
        if stamp_ns not in stamps_ns[-1:]:
            stamps_ns.append(stamp_ns)
        time.sleep(0.005)
    return float(np.percentile(np.diff(stamps_ns), 90)) / 1e9


@pytest.mark.skipif(
    not shutil.which("unshare") or subprocess.run(["unshare", "-Urm", "true"], check=False).returncode != 0,
    reason="a file system of one's own needs unshare(1) and user namespaces, which are not to be had here",
)
def test_robots_loops_and_acknowledged_tasks_outlast_full_disks_and_a_page_that_hangs(commands: Commands) -> None:
    words = ("arena_small", "--robots", "1", "--listen", "tcp/127.0.0.1:0", "--robot-files", ".")
    arena = commands.start("arena", *words)
    endpoint = commands.line_with(arena, "arena: arena_small at ").split(" at ")[1].split(",")[0]
    commands.line_with(commands.start("agent", "r1.toml"), "agent: r1 is up")
    at = ["--connect", endpoint]
    coordinator = SmallDisk(commands, "journal", ["coordinator", *at, "--journal", "{disk}/team.journal"])
    commands.line_with(coordinator.process, "of team")
    recorder = SmallDisk(commands, "runs", ["record", *at, "--no-visual", "-o", "{disk}/run.mcap"])
    commands.line_with(recorder.process, "recording to")
    dashboard = commands.start("dashboard", *at, "--port", "0")
    (url,) = re.findall(r"http://[\d.:]+", commands.line_with(dashboard, "http"))
    with Team.connect(endpoint, by="operator:ann") as client:
        before = [until(lambda: _accepted(client), "no task is accepted", pause_s=0.1) for _ in range(3)]
        quiet_s = period_s(client)
        with coordinator.full(), recorder.full(), unread_socket(url):
            refused = until(lambda: _refused(client), "tasks are still accepted")
            assert "database or disk is full" in refused
            assert period_s(client) < SLOWED * quiet_s
            commands.run_until(lambda ended: "the coordinator takes no tasks" in ended.stdout, "status", *at)
        after = until(lambda: _accepted(client), "no task is accepted although there is room", pause_s=0.1)
        commands.run_until(lambda ended: "takes no tasks" not in ended.stdout, "status", *at)
        kept = shutil.copytree(coordinator.folder, commands.folder / "kept")
        with closing(Journal(kept / "team.journal")) as journal:
            known = {name for name in (*before, after) if journal.find(name) is not None}
        assert known == {*before, after}


def _submit(client: Team) -> str:
    return client.submit("visit", place=(1.0, 1.0)).task.id


def _accepted(client: Team) -> str:
    try:
        return _submit(client)
    except CallError:
        return ""


def _refused(client: Team) -> str:
    try:
        _submit(client)
    except CallError as error:
        return f"{error} {error.detail}"
    return ""
