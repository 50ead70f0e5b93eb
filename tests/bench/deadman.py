"""Deadman: the process that drives a robot by hand is killed or stopped; how long the wheels still turn.

Arena, agent and holder are processes of this machine, on loopback. The wheels' encoders are heard here, on the robot's
CAN bus: counts come every 20 ms.
"""

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from robrain.agent.host.robot_file import RobotFile
from robrain.client.hand import Hand
from robrain.client.team import Team
from robrain.deploy.processes.arena_process import write_robot_files
from robrain.lab.bench.figure import Figure
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.sim.scenarios.scenario import Scenario
from tests.bench.live_team import await_ready, hub_and_children
from tests.bench.processes import p99_figure, running
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
            stops_s = [stop_after(at, sent, number) for number in range(rounds)]
            yield p99_figure(f"holder {how}: wheels stand, p99", stops_s, BOUND_MS, f"tries at {SPEED_M_S:g} m/s")


@contextmanager
def course() -> Iterator[Course]:
    """Start arena and agent; the robot has no plugin that drives by itself."""
    with hub_and_children() as (folder, hub, endpoint, children):
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
    with running("-m", "tests.bench.deadman", "hold", at.endpoint, str(speed_m_s), stderr=None) as holder:
        at.wheels.turn()
        time.sleep(np.random.default_rng(number).uniform(*DRIVEN_S))
        while not at.wheels.turns():  # the lease has lapsed, as this machine was busy, and is taken again
            at.wheels.arm()
            at.wheels.turn()
        began_s = time.perf_counter()
        os.kill(holder.pid, sent)
        at.wheels.stand()
        return at.wheels.turned_last_s - began_s


def hold(endpoint: str, speed_m_s: float) -> None:
    """Drive the robot, until something ends this process."""
    with Team.connect(endpoint, team=TEAM, by="bench") as team, Hand(team, ROBOT) as hand:
        hand.drive(HOLD_S, forward_m_s=speed_m_s)


if __name__ == "__main__":
    hold(sys.argv[2], float(sys.argv[3]))
