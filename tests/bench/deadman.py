"""Deadman: the process that drives a robot by hand is killed or stopped; how long the wheels still turn.

Arena, agent and holder are processes of this machine, on loopback. The wheels' encoders are heard here, on the robot's
CAN bus: counts come every 20 ms.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from rich.console import Console

from robrain.agent.host.robot_file import RobotFile
from robrain.client.hand import Hand
from robrain.client.team import Team
from robrain.deploy.processes.arena_process import write_robot_files
from robrain.deploy.processes.children import Children
from robrain.deploy.processes.live_process import ANY_PORT, open_hub
from robrain.lab.bench.figure import WIDTH, Figure, at_most, show_figures, timing
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.wire.session import listening_at
from robrain.sim.scenarios.scenario import Scenario
from tests.bench.live_team import await_ready
from tests.bench.responses import WheelMessages

ROUNDS = 20
BOUND_MS = 300.0
ROBOT = "r1"
TEAM = "deadman"
SPEED_M_S = 0.25
DRIVEN_S = (0.5, 0.9)
HOLD_S = 60.0
ROOM = """
[scenario]
name = "deadman_room"
seed = 1
[floor]
size_m = [7.0, 5.0]
resolution_m = 0.05
[team]
robots = 1
"""
SIGNALS = {"killed": signal.SIGKILL, "stopped": signal.SIGSTOP}


class Course(NamedTuple):
    """A robot in a room that only a hand drives."""

    endpoint: str
    wheels: WheelMessages


def measure(rounds: int = ROUNDS) -> Iterator[Figure]:
    """The figures, for a holder that is killed and for one that is stopped."""
    with course() as at:
        for how, sent in SIGNALS.items():
            stops_ms = [1e3 * stop_after(at, sent, number) for number in range(rounds)]
            median_ms, p99_ms = np.percentile(stops_ms, (50, 99))
            beside = f"{rounds} tries at {SPEED_M_S:g} m/s, median {median_ms:.0f} ms, slowest {max(stops_ms):.0f} ms"
            yield timing(f"holder {how}: wheels stand, p99", p99_ms, "ms", at_most(BOUND_MS), beside)


@contextmanager
def course() -> Iterator[Course]:
    """Start arena and agent; the robot has no plugin that drives by itself."""
    with (
        tempfile.TemporaryDirectory(prefix="robrain-deadman-") as name,
        closing(open_hub(ANY_PORT)[0]) as hub,
        Children() as children,
    ):
        folder, endpoint = Path(name), listening_at(hub)[0]
        scenario = folder / "deadman_room.toml"
        scenario.write_text(ROOM, encoding="utf-8")
        world = Scenario.from_file(scenario).world()
        (path,) = write_robot_files(world, folder, team=TEAM, connect=endpoint)
        _load_driver_alone(path)
        common = ["--connect", endpoint, "--team", TEAM]
        started = [
            children.start("arena", ["arena", str(scenario), *common]),
            children.start(ROBOT, ["agent", str(path)]),
        ]
        for child in started:
            await_ready(child)
        wheels = WheelMessages(ZenohBus(f"{ROBOT}/can0", session=hub, team=TEAM))
        try:
            yield Course(endpoint, wheels)
        finally:
            wheels.close()


def _load_driver_alone(path: Path) -> None:
    robot_file = msgspec.toml.decode(path.read_bytes(), type=RobotFile)
    table = msgspec.structs.replace(robot_file.robot, load=["driver"])
    kept = {name: each for name, each in robot_file.parameters.items() if name in ("driver", "mocdevice", "scan")}
    changed = msgspec.structs.replace(robot_file, robot=table, parameters=kept)
    path.write_bytes(msgspec.toml.encode(changed))


def stop_after(at: Course, sent: signal.Signals, number: int) -> float:
    """Have a process drive the robot, send it a signal, and return how long the wheels turned after that, seconds.

    Args:
        at: the robot.
        sent: the signal.
        number: of the try; draws when the signal is sent, and whether the robot is driven ahead or back.

    """
    speed_m_s = SPEED_M_S if number % 2 else -SPEED_M_S
    at.wheels.stand()
    at.wheels.arm()
    holder = subprocess.Popen([sys.executable, "-m", "tests.bench.deadman", "hold", at.endpoint, str(speed_m_s)])
    try:
        at.wheels.turn()
        time.sleep(np.random.default_rng(number).uniform(*DRIVEN_S))
        while not at.wheels.turns():  # the lease has lapsed, as this machine was busy, and is taken again
            at.wheels.arm()
            at.wheels.turn()
        began_s = time.perf_counter()
        os.kill(holder.pid, sent)
        at.wheels.stand()
        return at.wheels.turned_last_s - began_s
    finally:
        holder.kill()
        holder.wait()


def hold(endpoint: str, speed_m_s: float) -> None:
    """Drive the robot, until something ends this process."""
    with Team.connect(endpoint, team=TEAM, by="bench") as team, Hand(team, ROBOT) as hand:
        hand.drive(HOLD_S, forward_m_s=speed_m_s)


if __name__ == "__main__":
    if sys.argv[1:2] == ["hold"]:
        hold(sys.argv[2], float(sys.argv[3]))
    else:
        show_figures("Deadman", measure(int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS), Console(width=WIDTH))
