"""Halts and periods on a busy network: a fleet of agents, a flood, and a subscriber that reads nothing any more.

The agents are real processes with motor controller and driver. Put and stop frames are timed in this process, as in
`tests.bench.halt`; the states' periods by when they arrive here.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager

import numpy as np
import zenoh

from robrain.deploy.command_line.output import print_result
from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.protocol.can.frames import codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH, ROBOT_STATE
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, HALT, Halt
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_session
from tests.bench.live_team import hub_and_children
from tests.bench.processes import line_of, p99_figure, running, wait_for

ROBOTS = 20
HALTS = 20
TEAM = "congestion"
PATIENCE_S = 90.0
HALT_BOUND_MS = 50.0
JITTER_BOUND = 1.5
WATCHED_S = 6.0
FLOOD_BYTES = 200_000
SUMMARY_BYTES = 20_000
FLOOD_PAUSE_S = 0.01
ROBOT_FILE = """
[robot]
name = "{name}"
team = "{team}"
load = ["driver"]
[zenoh]
connect = ["{endpoint}"]
"""


class Fleet:
    """Halts a fleet and hears its buses and states.

    Args:
        session: the hub, in this process.
        robots: their names.

    """

    def __init__(self, session: zenoh.Session, robots: Sequence[str]) -> None:
        self.robots = robots
        self._wire = Endpoint(session, TEAM, LiveClock(), Drive.LIVE)
        self._halt = self._wire.publisher(HALT)
        self._states = Inbox(8192, every=True)
        self._wire.subscribe(self._states, ROBOT_STATE)
        self._stop_id = codec("Stop").arbitration_id
        self._stopped_s: dict[str, float] = {}
        self._changed = threading.Condition()
        self._ends = False
        self._buses = {name: ZenohBus(f"{name}/can0", session=session, team=TEAM) for name in robots}
        self._threads = [threading.Thread(target=self._listen, args=(name,), daemon=True) for name in robots]
        for thread in self._threads:
            thread.start()

    def halt_once(self, *, missing: Sequence[str] = ()) -> list[float]:
        """Halt all and resume; seconds from the put to each robot's stop frame."""
        self.until(halted=False, robots=[name for name in self.robots if name not in missing])
        with self._changed:
            self._stopped_s.clear()
        began_s = time.perf_counter()
        self._halt.put(Halt(halted=True, by="operator:bench"))
        wanted = len(self.robots) - len(missing)
        with self._changed:
            if not self._changed.wait_for(lambda: len(self._stopped_s) >= wanted, PATIENCE_S):
                raise TimeoutError(f"not reached: {sorted(set(self.robots) - set(self._stopped_s))}")
            took_s = [stopped_s - began_s for stopped_s in self._stopped_s.values()]
        self._halt.put(Halt(halted=False, by="operator:bench"))
        return took_s

    def until(self, *, halted: bool, robots: Sequence[str]) -> None:
        """Wait until all of them say so."""
        left = set(robots)
        self._states.drain()

        def have_all_said_so() -> bool:
            left.difference_update(each.message.robot for each in self._states.drain() if each.message.halted is halted)
            return not left

        wait_for(have_all_said_so, lambda: f"{sorted(left)} did not say halted={halted}", pause_s=0.002)

    def periods_s(self, robot: str, seconds: float) -> tuple[list[float], list[float]]:
        """Intervals of a robot's states: between their stamps, by its own work; and between arrivals."""
        self._states.drain()
        stamps_ns: list[int] = []
        arrived_s: list[float] = []
        until_s = time.monotonic() + seconds
        while (now_s := time.monotonic()) < until_s:
            for each in self._states.drain():
                if each.message.robot == robot:
                    stamps_ns.append(each.message.stamp_ns)
                    arrived_s.append(now_s)
            time.sleep(0.005)
        return [1e-9 * each for each in np.diff(stamps_ns)], [*np.diff(arrived_s), now_s - arrived_s[-1]]

    def close(self) -> None:
        """Leave the wire."""
        self._ends = True
        for thread in self._threads:
            thread.join()
        for bus in self._buses.values():
            bus.shutdown()
        self._wire.close()

    def _listen(self, name: str) -> None:
        bus = self._buses[name]
        while not self._ends:
            frame = bus.recv(timeout=0.1)
            if frame is not None and frame.arbitration_id == self._stop_id:
                with self._changed:
                    self._stopped_s.setdefault(name, time.perf_counter())
                    self._changed.notify_all()


@contextmanager
def fleet(count: int) -> Iterator[tuple[Fleet, str, dict[str, int]]]:
    """Start a hub and so many agents; the fleet, the hub's endpoint, and the agents' process ids."""
    with hub_and_children() as (folder, hub, endpoint, children):
        names = [f"r{number + 1}" for number in range(count)]
        started = Fleet(hub, names)
        try:
            pids = {}
            for robot in names:
                path = folder / f"{robot}.toml"
                path.write_text(ROBOT_FILE.format(name=robot, team=TEAM, endpoint=endpoint), encoding="utf-8")
                pids[robot] = children.start(robot, ["agent", str(path)]).pid
            started.until(halted=False, robots=names)
            yield started, endpoint, pids
        finally:
            started.close()


@contextmanager
def helper(role: str, endpoint: str) -> Iterator[subprocess.Popen[str]]:
    """Run `flood` or `read` in a process of its own, from the time at which it says that it is ready."""
    with running("-m", "tests.bench.congestion", role, endpoint, stdout=subprocess.PIPE, stderr=None) as process:
        line_of(process)
        yield process


@contextmanager
def stuck_reader(endpoint: str) -> Iterator[None]:
    """A process that subscribes to everything and then hangs; a flood fills what the hub keeps for it."""
    with helper("read", endpoint) as process:
        os.kill(process.pid, signal.SIGSTOP)
        yield


def flood(endpoint: str) -> None:
    """Publish large paths, which readers hear, and summaries that make no sense, which all robots hear, without end."""
    with closing(open_session(connect=[endpoint])) as session:
        wire = Endpoint(session, TEAM, LiveClock(), Drive.LIVE)
        floods = (
            (wire.publisher(ROBOT_PATH, robot="flood"), FLOOD_BYTES),
            (wire.publisher(COORDINATOR_STATE), SUMMARY_BYTES),
        )

        def put(publisher: Publisher, size: int) -> None:
            while True:
                publisher.put_bytes(b" " * size)
                time.sleep(FLOOD_PAUSE_S)

        threads = [threading.Thread(target=put, args=each) for each in floods]
        for thread in threads:
            thread.start()
        print_result("ready")
        for thread in threads:
            thread.join()


def read(endpoint: str) -> None:
    """Subscribe to everything of every team."""
    with closing(open_session(connect=[endpoint])) as session:
        session.declare_subscriber("robrain/**", zenoh.handlers.RingChannel(8))
        print_result("ready")
        threading.Event().wait()


def measure(robots: int = ROBOTS, halts: int = HALTS) -> Iterator[Figure]:
    """The figures."""
    with fleet(robots) as (team, endpoint, _), ExitStack() as stack:
        team.halt_once()
        yield _halts(team, f"{robots} robots halted: put to stop frame, p99", halts)
        quiet_s = team.periods_s("r1", WATCHED_S)
        stack.enter_context(helper("read", endpoint))
        stack.enter_context(helper("flood", endpoint))
        yield _halts(team, f"{robots} robots halted, network flooded: put to stop frame, p99", halts)
        flooded_s = team.periods_s("r1", WATCHED_S)
        stack.enter_context(stuck_reader(endpoint))
        time.sleep(1.0)
        stuck_s = team.periods_s("r1", WATCHED_S)
        yield _halts(team, f"{robots} robots halted, flooded, one reader hangs: put to stop frame, p99", halts)
        for by, quiet, flooded, stuck in zip(("made", "heard"), quiet_s, flooded_s, stuck_s, strict=True):
            quiet_ms, base_ms, beside_ms = (1e3 * float(np.percentile(each, 99)) for each in (quiet, flooded, stuck))
            beside = f"p99 of the period {quiet_ms:.0f} ms alone, {base_ms:.0f} ms flooded, {beside_ms:.0f} ms then"
            yield timing(f"a reader hangs: p99 of the period in which states are {by}, over that before",
                         beside_ms / base_ms, "×", at_most(JITTER_BOUND), beside)  # fmt: skip


def _halts(team: Fleet, name: str, halts: int) -> Figure:
    return p99_figure(name, [each for _ in range(halts) for each in team.halt_once()], HALT_BOUND_MS, "stops")


if __name__ == "__main__":
    {"flood": flood, "read": read}[sys.argv[1]](sys.argv[2])
