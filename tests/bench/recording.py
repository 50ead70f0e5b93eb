"""Recordings: what 10,000 messages a second cost the recorder, and how long a seek takes in an hour.

Costs are CPU time, which other work on the machine changes little.
"""

import os
import subprocess
import tempfile
import time
from pathlib import Path

import msgspec
import numpy as np
from mcap.writer import CompressionType, Writer

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.protocol.clock import LiveClock
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from robrain.recording.provenance import Provenance
from robrain.recording.replay.player import Player
from robrain.recording.writer.recorder import Recorder
from tests.bench.processes import LOOPBACK, line_of, running

RATE_HZ = 10_000
ROBOTS = 50
SECONDS = 5.0
CORE_BOUND = 0.20
SEEK_BOUND_S = 0.2
HOUR_S = 3600
NS_PER_S = 1_000_000_000
PROVENANCE = Provenance("bench", "", 1, None, "live", "default")

SPEAKER = f"""
import sys, time
import msgspec
from tests.bench.recording import state
from robrain.protocol.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_session
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE

session = open_session(connect=[sys.argv[1]])
wire = Endpoint(session, "default", LiveClock(), Drive.LIVE)
publishers = [wire.publisher(ROBOT_STATE, robot=f"r{{number}}") for number in range({ROBOTS})]
states = [state(f"r{{number}}", number) for number in range({ROBOTS})]
time.sleep(1.0)
print("speaking", flush=True)
started_s, put = time.monotonic(), 0
while (passed_s := time.monotonic() - started_s) < float(sys.argv[2]):
    while put < passed_s * {RATE_HZ}:
        publishers[put % {ROBOTS}].put(states[put % {ROBOTS}])
        put += 1
    time.sleep(0.002)
time.sleep(0.5)
print(put, flush=True)
wire.close()
session.close()
"""


def state(robot: str, place: float) -> RobotState:
    battery = BatteryState(voltage_v=24.5, current_a=1.25, temperature_c=31.5, soc=0.75, remaining_j=250000.0)
    pose = Pose2D(place % 20, place % 13, place % 3)
    return RobotState(robot=robot, pose=pose, pose_covariance=(0.01,) * 9, radius_m=0.2, battery=battery)


def recorder_share(seconds: float, folder: Path, *, visual: bool) -> dict[str, float]:
    """Share of a core that the recorder's process takes, all of Zenoh's reception included."""
    session = open_session(mode="router", listen=[LOOPBACK])
    wire = Endpoint(session, "default", LiveClock(), Drive.LIVE)
    recorder = Recorder(wire, folder / f"rate_{visual}.mcap", PROVENANCE, visual=visual)
    words = ("-c", SPEAKER, listening_at(session)[0], str(seconds))
    try:
        with running(*words, stdout=subprocess.PIPE, stderr=None) as speaker:
            line_of(speaker)
            began_s, cpu_s, before = time.monotonic(), time.process_time(), recorder.messages
            while speaker.poll() is None:
                recorder.step()
                time.sleep(0.05)
            recorder.step()
            passed_s, cpu_s = time.monotonic() - began_s - 0.5, time.process_time() - cpu_s
            put = int(line_of(speaker))
    finally:
        summary = recorder.close()
        wire.close()
        session.close()
    heard = summary.messages - before
    cpu_us = 1e6 * cpu_s / max(heard, 1)
    return {"cpu_us": cpu_us, "rate_hz": heard / passed_s, "put": put, "heard": heard, "lost": summary.lost}


def write_hour(path: Path, robots: int = 4, motes: int = 24, task_every_s: float = 5.0) -> int:
    """An hour of a team, written straight into a file in chunks of half a second."""
    rng = np.random.default_rng(1)
    geometry = GridGeometry(0.1, 0.0, 0.0, 240, 140)
    encode = msgspec.json.encode
    count = 0
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 30, compression=CompressionType.ZSTD)
        writer.start()
        channels: dict[str, int] = {}

        def put(key: str, message: msgspec.Struct, now_ns: int) -> None:
            nonlocal count
            if key not in channels:
                channels[key] = writer.register_channel(f"robrain/default/{key}", "json", 0)
            writer.add_message(channels[key], now_ns, encode(message), now_ns)
            count += 1

        for tick in range(HOUR_S * 10):
            now_ns = tick * NS_PER_S // 10
            for number in range(robots):
                put(f"robot/r{number}/state", state(f"r{number}", tick / 10 + number), now_ns)
                if tick % 5 == number % 5:
                    row, column = int(rng.integers(0, 120)), int(rng.integers(0, 220))
                    cells = rng.choice(np.array([-1, 0, 0, 100], np.int8), (20, 20))
                    patch = to_message(f"r{number}", geometry, PatchCells(row, column, cells, tick * 100))
                    put(f"robot/r{number}/map", patch, now_ns)
            if tick % 40 == 0:
                for number in range(motes):
                    reading = MoteReading(mote=f"m{number}", place=Point2D(1.0, 2.0), quantity="temperature_c",
                                          value=20.0, voltage_v=2.9, rssi_dbm=-70, via="r1")  # fmt: skip
                    put(f"mote/m{number}/reading", reading, now_ns)
            if tick % round(10 * task_every_s) == 0:
                task = Task(id=f"t{tick}", kind="visit", place=Point2D(1.0, 2.0))
                for state_ in (TaskState.QUEUED, TaskState.RUNNING, TaskState.DONE):
                    put(f"task/event/t{tick}", TaskEvent(task=task, state=state_, robot="r1"), now_ns)
            if tick % 5 == 4:
                writer.flush()  # type: ignore[no-untyped-call]
        writer.finish()  # type: ignore[no-untyped-call]
    return count


def seeks(path: Path) -> dict[str, float]:
    """CPU seconds to open and prepare a recording, and to seek in it at random."""
    began_s = time.process_time()
    player = Player(path)
    opened_s = time.process_time() - began_s
    began_s = time.process_time()
    player.prepare()
    prepared_s = time.process_time() - began_s
    rng = np.random.default_rng(2)
    took_s = []
    for t_s in rng.uniform(0, player.duration_s, 40):
        began_s = time.process_time()
        player.seek(float(t_s))
        took_s.append(time.process_time() - began_s)
    return {"open": opened_s, "prepare": prepared_s, "median": float(np.median(took_s)), "worst": max(took_s)}


def measure() -> list[Figure]:
    """Every figure, in order."""
    figures = []
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(Path.cwd()), os.environ.get("PYTHONPATH", "")]))
    with tempfile.TemporaryDirectory(prefix="robrain-bench-") as name:
        folder = Path(name)
        for visual in (False, True):
            told = recorder_share(SECONDS, folder, visual=visual)
            share = told["cpu_us"] * RATE_HZ / 1e6
            what = f"recorder at {RATE_HZ} messages a second" + (", with what Foxglove draws" if visual else "")
            beside = (
                f"{told['cpu_us']:.1f} µs a message with its reception; {told['rate_hz']:.0f} a second came, "
                f"{told['put'] - told['heard']:.0f} were not heard"
            )
            figures.append(timing(f"{what}: share of a core", 100 * share, "%", at_most(100 * CORE_BOUND), beside))
            figures.append(timing(f"{what}: messages lost", told["lost"]))
        path = folder / "hour.mcap"
        count = write_hour(path)
        took = seeks(path)
        beside = (
            f"{count} messages, {path.stat().st_size / 1e6:.0f} MB; median {1000 * took['median']:.0f} ms; opened in "
            f"{took['open']:.2f} s, prepared in {took['prepare']:.1f} s"
        )
        what = "seek in an hour of 4 robots, worst of 40"
        figures.append(timing(what, 1000 * took["worst"], "ms", at_most(1000 * SEEK_BOUND_S), beside))
    return figures
