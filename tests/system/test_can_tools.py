"""python-can's own tools on a robot in a live arena, and a log of theirs replayed into a robot without an arena."""

import contextlib
import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import can
import pytest

from robrain.agent.host import AgentHost
from robrain.agent.robot_file import RobotFile, RobotTable
from robrain.protocol.can.frames import codec, database
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.model.omni_drive import OmniBase
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.session import listening_at, open_session
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

WHEELS = ("wheel_1_rad_s", "wheel_2_rad_s", "wheel_3_rad_s")


@pytest.fixture
def arena(commands) -> str:
    """A live arena with a robot r1; its endpoint."""
    process = commands.start("arena", "arena_small", "--listen", "tcp/127.0.0.1:0")
    line = commands.line_with(process, "robots r1")
    return re.search(r"tcp/127\.0\.0\.1:\d+", line).group()


def tool(name: str, *words: str) -> list[str]:
    return [sys.executable, "-m", f"can.{name}", *words]


def log_a_drive(endpoint: str, log: Path) -> None:
    """Have python-can's logger write what passes on r1's bus while it is driven ahead for two seconds."""
    words = ("-i", "zenoh", "-c", "r1/can0", "-f", str(log), "--bus-kwargs", f"connect={endpoint}")
    with subprocess.Popen(tool("logger", *words), stdout=subprocess.DEVNULL) as logger:
        try:
            until(lambda: log.exists() and log.stat().st_size > 10_000, "the logger writes nothing")
            speeds = dict(zip(WHEELS, OmniBase().wheel_speeds_rad_s(Twist2D(0.2)), strict=True))
            with ZenohBus("r1/can0", connect=endpoint) as host:
                for number in range(40):
                    host.send(codec("WheelCommand").pack(number, **speeds))
                    time.sleep(0.05)
            logger.send_signal(signal.SIGINT)
            logger.wait(PATIENCE_S)
        finally:
            logger.kill()


def test_the_logger_writes_what_passes_on_a_simulated_robot_s_bus(arena, tmp_path) -> None:
    log = tmp_path / "drive.log"
    log_a_drive(arena, log)
    lines = log.read_text().splitlines()
    assert re.fullmatch(r"\(\d+\.\d{6}\) .+ [0-9A-F]{3}#[0-9A-F]+( [RT])?", lines[0]), lines[0]
    with can.CanutilsLogReader(log) as reader:
        frames = list(reader)
    names = {message.frame_id: message.name for message in database().messages}
    counts = dict.fromkeys(names.values(), 0)
    for frame in frames:
        counts[names[frame.arbitration_id]] += 1
        codec(names[frame.arbitration_id]).unpack(frame)  # every one of them is whole
    assert counts["WheelCommand"] == 40
    assert counts["WheelEncoders"] > 100
    assert min(counts[name] for name in ("MotorStatus", "BatteryStatus", "RangeRing1", "Bumps")) > 0
    elapsed_s = frames[-1].timestamp - frames[0].timestamp
    assert counts["WheelEncoders"] / elapsed_s == pytest.approx(50, rel=0.2)


def test_a_log_that_is_played_into_a_robot_moves_its_odometry_as_the_drive_did(arena, tmp_path) -> None:
    log = tmp_path / "drive.log"
    log_a_drive(arena, log)
    hub = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
    robot_file = RobotFile(robot=RobotTable("r7", load=["mocdevice"]), parameters={"mocdevice": {"silent_s": 60.0}})
    host = AgentHost(robot_file, Path(), hub, WallClock(), Drive.LOCKSTEP)
    try:
        host.start()
        words = ("-i", "zenoh", "-c", "r7/can0", "--ignore-timestamps", "-g", "0.002", str(log))
        player = tool("player", "--bus-kwargs", f"connect={listening_at(hub)[0]}", *words)
        with subprocess.Popen(player, stdout=subprocess.DEVNULL) as playing:
            while playing.poll() is None:
                host.step()
                time.sleep(0.01)
        device = host.manager.get("mocdevice").plugin
        until(lambda: device.pose().x_m > 0.3, "the robot has not moved", step=host.step)  # type: ignore[attr-defined]
        time.sleep(0.5)
        host.step()
        counters = device.counters()  # type: ignore[attr-defined]
        assert counters.believed > 50
        assert counters.rejected == 0
        # Two seconds at 0.2 m/s, less what it takes to speed up, and the watchdog's 200 ms at the end.
        assert 0.3 < device.pose().x_m < 0.55  # type: ignore[attr-defined]
        assert abs(device.pose().y_m) < 0.02  # type: ignore[attr-defined]
    finally:
        host.close()
        hub.close()


def test_the_viewer_shows_the_frames_of_a_simulated_robot(arena) -> None:
    screen, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
    viewer = subprocess.Popen(
        tool("viewer", "-i", "zenoh", "-c", "r1/can0", "--bus-kwargs", f"connect={arena}"),
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        env={**os.environ, "TERM": "xterm"},
    )
    os.close(terminal)
    shown = b""
    try:
        deadline_s = time.monotonic() + PATIENCE_S
        while not all(name in shown for name in (b"0x180", b"0x181", b"0x200", b"0x280")):
            assert time.monotonic() < deadline_s, shown.decode(errors="replace")
            with contextlib.suppress(OSError):
                shown += os.read(screen, 65536)
    finally:
        viewer.terminate()
        viewer.wait(PATIENCE_S)
        os.close(screen)
