"""What an agent weighs: memory, threads and time to its start, of `robrain agent` as a process of its own.

The host alone has mocdevice, driver and command, and what these require. The full stack explores the depot with all
stock plugins, beside an arena and a coordinator in other processes. Resident is what the kernel counts for the process
(`VmRSS`): pages that it shares with others count whole. A MB is 1024 KiB here, as `du` and the kernel count.
"""

import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import NamedTuple

import zenoh

from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.protocol.wire.session import listening_at, open_session
from tests.bench.processes import LOOPBACK, PATIENCE_S, ROBRAIN, running, wait_for
from tests.system.plain_install import plain_size_mb

ALONE = '[robot]\nname = "r1"\nload = ["mocdevice", "driver", "command"]\n'
STARTS = 5
SETTLED_S = 3.0
EXPLORING_S = 25.0
"""Time after which the full stack has loaded every kernel that it uses."""
LOOK_S = 0.5


class Weight(NamedTuple):
    """What a process has."""

    resident_mb: float
    threads: int


def measure() -> Iterator[Figure]:
    """The host alone, the full stack, and the plain install."""
    with open_session(mode="router", listen=[LOOPBACK]) as hub, tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "alone.toml").write_text(ALONE)
        weights, starts_s = [], []
        for _ in range(STARTS):
            with _agent(hub, place / "alone.toml") as (process, start_s):
                starts_s.append(start_s)
                weights.append(_most(process.pid, SETTLED_S))
        yield timing("host alone: resident", median(each.resident_mb for each in weights), "MB", at_most(60.0))
        yield timing("host alone: threads", max(each.threads for each in weights), "", at_most(16))
        beside = f"slowest {max(starts_s):.2f} s"
        yield timing("host alone: from exec to alive", median(starts_s), "s", at_most(0.6), beside)
        with _team(hub, place), _agent(hub, place / "r1.toml") as (process, _):
            time.sleep(EXPLORING_S)
            full = _most(process.pid, SETTLED_S)
        yield timing("full stack, exploring: resident", full.resident_mb, "MB", at_most(160.0))
        yield timing("full stack, exploring: threads", full.threads, "", at_most(30))
    yield timing("plain install: on disk", plain_size_mb(), "MB", at_most(170.0), "with pip and setuptools")


def weigh(pid: int) -> Weight:
    """The weight of a process, on Linux."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    facts = {name: value.split()[0] for name, _, value in (line.partition(":") for line in lines) if value.split()}
    return Weight(int(facts["VmRSS"]) / 1024, int(facts["Threads"]))


def _most(pid: int, for_s: float) -> Weight:
    """The median of the memory and the most threads within a time."""
    seen = []
    until_s = time.monotonic() + for_s
    while time.monotonic() < until_s:
        time.sleep(LOOK_S)
        seen.append(weigh(pid))
    return Weight(median(each.resident_mb for each in seen), max(each.threads for each in seen))


@contextmanager
def _agent(hub: zenoh.Session, robot_file: Path) -> Iterator[tuple[subprocess.Popen[str], float]]:
    """A robot, and how long it took from exec to its token."""
    alive = threading.Event()

    def hear(sample: zenoh.Sample) -> None:
        if str(sample.key_expr).endswith("/r1/alive") and sample.kind == zenoh.SampleKind.PUT:
            alive.set()

    token = hub.liveliness().declare_subscriber("robrain/**", zenoh.handlers.Callback(hear, indirect=False))
    try:
        began_s = time.monotonic()
        with running(*ROBRAIN, "agent", str(robot_file), "--connect", listening_at(hub)[0]) as process:
            if not alive.wait(PATIENCE_S):
                raise RuntimeError(f"{robot_file.name} is not alive after {PATIENCE_S:g} s")
            yield process, time.monotonic() - began_s
    finally:
        token.undeclare()


@contextmanager
def _team(hub: zenoh.Session, place: Path) -> Iterator[None]:
    where = listening_at(hub)[0]
    arena = ("arena", "depot", "--robots", "1", "--seed", "3", "--robot-files", str(place), "--connect", where)
    with (
        running(*ROBRAIN, *arena),
        running(*ROBRAIN, "coordinator", "--connect", where, "--journal", str(place / "team.journal")),
    ):
        wait_for((place / "r1.toml").is_file, "the arena has written no robot's file", pause_s=LOOK_S)
        yield
