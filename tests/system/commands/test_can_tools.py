"""python-can's own tools on a robot in a live arena, and a log of theirs replayed into a robot without an arena."""

import io
import itertools
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import can
import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.can.frames import codec, database
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH
from robrain.protocol.model.geometry import Twist2D
from tests.system.conftest import Commands, member_at
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

DISTANCE_M = 0.3
WHEELS = ("wheel_1_rad_s", "wheel_2_rad_s", "wheel_3_rad_s")


@pytest.fixture(scope="module")
def arena(tmp_path_factory) -> Iterator[str]:
    """A live arena with a robot r1; its endpoint."""
    commands = Commands(tmp_path_factory.mktemp("arena"))
    process = commands.start("arena", "arena_small", "--listen", "tcp/127.0.0.1:0")
    line = commands.line_with(process, "robots r1")
    yield re.search(r"tcp/127\.0\.0\.1:\d+", line).group()
    commands.stop_all()


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """Where the drive is logged."""
    return tmp_path_factory.mktemp("log") / "drive.log"


@pytest.fixture(scope="module")
def driven(arena: str, log: Path) -> "Driven":
    """A drive that was logged, before anything else moved the robot."""
    return log_a_drive(arena, log)


def tool(name: str, *words: str) -> list[str]:
    return [sys.executable, "-m", f"can.{name}", *words]


class Driven(NamedTuple):
    """A drive that was logged."""

    commands: int
    distance_m: float
    """How far the robot really came."""


def log_a_drive(endpoint: str, log: Path) -> Driven:
    """Have python-can's logger write what passes on r1's bus while it is driven ahead, and until it stands."""
    words = ("-i", "zenoh", "-c", "r1/can0", "-f", str(log), "--bus-kwargs", f"connect={endpoint}")
    truths = Inbox()

    def driven_m() -> float:
        truths.drain()
        return float(until(truths.drain)[-1].message.robots[0].distance_m)

    with member_at(endpoint) as wire, subprocess.Popen(tool("logger", *words), stdout=subprocess.DEVNULL) as logger:
        wire.subscribe(truths, ARENA_TRUTH)
        try:
            until(lambda: log.exists() and log.stat().st_size > 10_000, "the logger writes nothing")
            speeds = dict(zip(WHEELS, OmniBase().wheel_speeds_rad_s(Twist2D(0.2)), strict=True))
            number = itertools.count()
            with ZenohBus("r1/can0", connect=endpoint) as host:

                def drive() -> None:
                    host.send(codec("WheelCommand").pack(next(number) % 256, **speeds))

                until(lambda: driven_m() > DISTANCE_M, "the robot does not drive", step=drive, pause_s=0.05)
            until(lambda: driven_m() == driven_m(), "the robot does not stand")
            # The logger writes by the block: after some more of them, all of the drive is in the file.
            blocks = log.stat().st_size + 2 * io.DEFAULT_BUFFER_SIZE
            until(lambda: log.stat().st_size >= blocks, "the logger writes no more")
            logger.send_signal(signal.SIGINT)
            logger.wait(PATIENCE_S)
            return Driven(next(number), driven_m())
        finally:
            logger.kill()


def test_the_logger_writes_what_passes_on_a_simulated_robot_s_bus(log: Path, driven: "Driven") -> None:
    lines = log.read_text().splitlines()
    assert re.fullmatch(r"\(\d+\.\d{6}\) .+ [0-9A-F]{3}#[0-9A-F]+( [RT])?", lines[0]), lines[0]
    with can.CanutilsLogReader(log) as reader:
        frames = list(reader)
    names = {message.frame_id: message.name for message in database().messages}
    counts = dict.fromkeys(names.values(), 0)
    for frame in frames:
        counts[names[frame.arbitration_id]] += 1
        codec(names[frame.arbitration_id]).unpack(frame)  # every one of them is whole
    assert counts["WheelCommand"] == driven.commands
    assert counts["WheelEncoders"] > 100
    assert min(counts[name] for name in ("MotorStatus", "BatteryStatus", "RangeRing1", "Bumps")) > 0
    # In the arena's time, which a busy machine stretches: encoders at 50 Hz, the battery at 5 Hz. They come in order;
    # some may be missing, as an arena drops frames rather than wait for a network that is busy.
    assert counts["WheelEncoders"] / counts["BatteryStatus"] == pytest.approx(10, rel=0.2)
    numbers = [codec("WheelEncoders").unpack(frame)["counter"] for frame in frames if frame.arbitration_id == 0x180]
    steps = [(after - before) % 256 for before, after in itertools.pairwise(numbers)]
    assert min(steps) > 0
    assert sum(steps) < 1.2 * len(steps)
