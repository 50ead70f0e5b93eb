"""Bring-up's motions on real hardware, or on that of a live arena: the host runs on a thread of its own."""

import threading
import time
from pathlib import Path

import zenoh

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import run_agent
from robrain.agent.host.robot_file import RobotFile
from robrain.deploy.bringup.bench import START_S, Bench, DeviceAbsent, bench_file
from robrain.protocol.wire.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.errors import RobrainError

CLOSE_S = 5.0
LOOK_S = 0.01


class LiveBench(Bench):
    """See Bench.

    Args:
        session: closed by its owner, after this.
        base: folder of the robot's file.

    """

    def __init__(self, session: zenoh.Session, base: Path) -> None:
        self._session, self._base = session, base
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._failed: RobrainError | None = None

    def start(self, robot_file: RobotFile, *, with_lidar: bool, with_imu: bool = False) -> None:
        """As Bench."""
        self.close()
        self._stop = threading.Event()
        self._failed = None
        own = bench_file(robot_file, self._base, with_lidar=with_lidar, with_imu=with_imu)
        self.host = AgentHost(own, self._base, self._session, LiveClock(), Drive.LIVE)
        ready = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(self.host, self._stop, ready), name="bringup-host")
        self._thread.start()
        began_s = time.monotonic()
        while not ready.wait(LOOK_S):
            self._check()
            if time.monotonic() - began_s > 10 * START_S:
                raise DeviceAbsent("the devices do not start")
        self._check()

    def pass_time(self, seconds: float) -> None:
        """As Bench."""
        time.sleep(seconds)
        self._check()

    def close(self) -> None:
        """As Bench."""
        thread, self._thread = self._thread, None
        self._stop.set()
        if thread is not None:
            thread.join(CLOSE_S)

    def _run(self, host: AgentHost, stop: threading.Event, ready: threading.Event) -> None:
        try:
            run_agent(host, stop.is_set, ready.set)
        except RobrainError as error:
            self._failed = error
            ready.set()

    def _check(self) -> None:
        if self._failed is not None:
            raise self._failed
        if self._thread is not None and not self._thread.is_alive():
            raise DeviceAbsent("the host of the devices has ended")
