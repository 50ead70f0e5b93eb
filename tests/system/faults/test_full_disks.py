"""Full disks under journal and recording, and a page that hangs: robots work on, and operators are told."""

import re
import shutil
import sys
import time
from contextlib import closing

import numpy as np
import pytest

from robrain import Team
from robrain.coordinator.journal.journal import Journal
from robrain.protocol.errors import CallError
from tests.system.conftest import Commands
from tests.system.hanging import unread_socket
from tests.system.small_disk import SmallDisk, can_have_small_disks
from tests.waiting import until

pytestmark = pytest.mark.system
WATCHED_S = 2.0
SLOWED = 1.5


def on_a_small_disk(commands: Commands, name: str, words: list[str]) -> SmallDisk:
    disk = commands.folder / name
    command = [sys.executable, "-m", "robrain.cli", *(word.format(disk=disk) for word in words)]
    started = SmallDisk(disk, command, size="8m")
    commands.adopt(started.process)
    return started


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


@pytest.mark.skipif(not can_have_small_disks(), reason="no file system of its own is to be had here")
def test_robots_loops_and_acknowledged_tasks_outlast_full_disks_and_a_page_that_hangs(commands: Commands) -> None:
    endpoint = commands.arena("arena_small", "--robots", "1")
    commands.agents("r1")
    at = ["--connect", endpoint]
    coordinator = on_a_small_disk(commands, "journal", ["coordinator", *at, "--journal", "{disk}/team.journal"])
    commands.line_with(coordinator.process, "of team")
    recorder = on_a_small_disk(commands, "runs", ["record", *at, "--no-visual", "-o", "{disk}/run.mcap"])
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
            commands.run_until(lambda ended: "accepts no tasks" in ended.stdout, "status", *at)
        after = until(lambda: _accepted(client), "no task is accepted although there is room", pause_s=0.1)
        commands.run_until(lambda ended: "accepts no tasks" not in ended.stdout, "status", *at)
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
