"""Emergency halt: from the put of `halt` in one process to the stop frame on the CAN bus of a robot in another.

The robot is `robrain agent` with the stock motor controller and driver. The put and the listening are done here, so the
figure holds two ways over TCP loopback: the halt's to the robot, and the frame's back.
"""

import tempfile
import textwrap
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import zenoh

from robrain.lab.bench.figure import Figure
from robrain.protocol.can.frames import codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from tests.bench.processes import LOOPBACK, PATIENCE_S, ROBRAIN, p99_figure, running, wait_for

ROUNDS = 300
BOUND_MS = 20.0

SPOILERS = """
import threading
from robrain.agent.plugin import Device

class Spinning(Device):
    period_s = 0.02

    def step(self) -> None:
        while True:
            pass

class Holding(Device):
    period_s = 0.02

    def step(self) -> None:
        threading.Event().wait()

class Stuck(Device):
    def emergency_halt(self) -> None:
        while True:
            pass
"""
CASES = {
    "nothing else": (),
    "a plugin spins": ("spinning",),
    "one spins, one holds its lock": ("spinning", "holding"),
    "one spins, one holds its lock, one spins in emergency_halt": ("spinning", "holding", "stuck"),
}


def measure(rounds: int = ROUNDS) -> Iterator[Figure]:
    """Halt and resume a robot so often, for each case."""
    for case, spoilers in CASES.items():
        with open_session(mode="router", listen=[LOOPBACK]) as session, _robot(session, spoilers) as stopwatch:
            stopwatch.halt_once()  # the first one loads code
            durations_s = [stopwatch.halt_once() for _ in range(rounds)]
        yield p99_figure(f"put to stop frame, {case}: p99", durations_s, BOUND_MS, "halts")


class Stopwatch:
    """Halts a robot and hears its bus."""

    def __init__(self, session: zenoh.Session) -> None:
        self._wire = Endpoint(session, "default", LiveClock(), Drive.LIVE)
        self._halt = self._wire.publisher(HALT)
        self._states = Inbox()
        self._wire.subscribe(self._states, ROBOT_STATE)
        self._bus = ZenohBus("r1/can0", session=session)
        self._stop_id = codec("Stop").arbitration_id
        self._pause = np.random.default_rng(1)

    def halt_once(self) -> float:
        """Halt, wait for the stop frame, resume; the seconds that it took."""
        self.until(halted=False)
        time.sleep(self._pause.uniform(0.005, 0.03))  # in no step with the robot's own periods
        while self._bus.recv(timeout=0) is not None:
            pass
        began_s = time.perf_counter()
        self._halt.put(Halt(halted=True, by="operator:bench"))
        while (frame := self._bus.recv(timeout=PATIENCE_S)) is not None and frame.arbitration_id != self._stop_id:
            pass
        took_s = time.perf_counter() - began_s
        if frame is None:
            raise TimeoutError("the robot sent no stop frame")
        self.until(halted=True)
        self._halt.put(Halt(halted=False, by="operator:bench"))
        return took_s

    def until(self, *, halted: bool) -> None:
        """Wait until the robot says so."""
        trouble = f"the robot did not say halted={halted}"
        wait_for(lambda: any(each.message.halted is halted for each in self._states.drain()), trouble, pause_s=0.001)

    def close(self) -> None:
        """Leave the wire."""
        self._bus.shutdown()
        self._wire.close()


@contextmanager
def _robot(session: zenoh.Session, spoilers: tuple[str, ...]) -> Iterator[Stopwatch]:
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "spoilers.py").write_text(SPOILERS, encoding="utf-8")
        for spoiler in spoilers:
            manifest = f'[plugin]\nclass = "spoilers:{spoiler.capitalize()}"\n[tag]\nhang_s = 3600.0\n'
            (place / f"{spoiler}.toml").write_text(manifest, encoding="utf-8")
        load = ", ".join(f'"{plugin}"' for plugin in ("driver", *spoilers))
        robot_file = f"""
            [robot]
            name = "r1"
            places = ["."]
            load = [{load}]
            [zenoh]
            connect = ["{listening_at(session)[0]}"]
            """
        (place / "r1.toml").write_text(textwrap.dedent(robot_file), encoding="utf-8")
        with closing(Stopwatch(session)) as stopwatch, running(*ROBRAIN, "agent", str(place / "r1.toml")):
            yield stopwatch
