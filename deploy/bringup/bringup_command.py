"""`robrain bringup ROBOT.toml`: the session, the claim on the robot's name, and the output for the person."""

import os
import signal
import sys
import threading
import time
from contextlib import ExitStack, closing
from pathlib import Path
from types import FrameType

import zenoh

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import run_agent
from robrain.agent.host.robot_file import RobotFile, TlsTable, folder_of, read_robot_file
from robrain.deploy.bringup.bench import START_S, Bench, DeviceAbsent, bench_file
from robrain.deploy.bringup.bring_up import BringUp, BringUpOptions
from robrain.deploy.bringup.findings import BringUpOperator, CheckFinding, TerminalOperator
from robrain.deploy.command_line.output import print_json, print_message
from robrain.deploy.command_line.terminal import print_line
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.agent_process import endpoints_of
from robrain.deploy.processes.name_claim import claim_robot
from robrain.deploy.processes.process_setup import limit_zenoh_threads
from robrain.protocol.access.identity import TLS_VARIABLE
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import NobodyThere, RobrainError
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.session import may_answer, open_lockstep_session, open_session
from robrain.protocol.workers import OwnedThread

CLOSE_S = 5.0
POLL_S = 0.01


class LiveBench(Bench):
    """See Bench.

    Args:
        session: closed by its owner, after this.
        base: folder of the robot's file.

    """

    def __init__(self, session: zenoh.Session, base: Path) -> None:
        self._session, self._base = session, base
        self._thread: OwnedThread | None = None
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
        self._thread = OwnedThread("bringup-host", self._run, self.host, self._stop, ready)
        began_s = time.monotonic()
        while not ready.wait(POLL_S):
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
            thread.close(CLOSE_S)

    def _run(self, host: AgentHost, stop: threading.Event, ready: threading.Event) -> None:
        try:
            run_agent(host, stop.is_set, ready.set)
        except RobrainError as error:
            self._failed = error
            ready.set()

    def _check(self) -> None:
        if self._failed is not None:
            raise self._failed
        if self._thread is not None and not self._thread.is_alive:
            raise DeviceAbsent("the host of the devices has ended")


MARKS = {True: "ok", False: "WRONG", None: "unknown"}
ON_THE_WIRE = ("zenoh",)
"""Interfaces of a base that is reached over the team's wire, as a simulated one is."""


def bringup_command(robot: Path, connect: str | None, wanted: BringUpOptions, *, yes: bool, as_json: bool) -> bool:
    """Bring a robot up; whether all steps are right.

    Args:
        robot: its ROBOT.toml.
        connect: endpoint of the team; None uses the file's, else $ROBRAIN_CONNECT, else this machine's hub.
        wanted: steps and limits.
        yes: give the default answer to all questions.
        as_json: print a `Report`.

    Raises:
        RobrainError: in one sentence; among others NameInUse if the robot's agent runs.

    """
    limit_zenoh_threads()
    robot_file = read_robot_file(robot)
    if not yes and not sys.stdin.isatty():
        raise UsageError("bringup asks a person beside the robot: run it at a terminal, or with --yes")
    operator = BringUpOperator() if yes else TerminalOperator()
    signal.signal(signal.SIGTERM, _interrupt)
    with ExitStack() as stack:
        session = stack.enter_context(closing(_open(robot_file, robot.parent, connect)))
        claim = stack.enter_context(claim_robot(session, robot_file.robot.team, robot_file.robot.name))
        claim.acquire(lambda text: print_message(f"bringup: {text}"), lambda: False)
        bench = LiveBench(session, robot.parent)
        stack.callback(bench.close)
        print_text = print_message if as_json else print_line

        def show(finding: CheckFinding) -> None:
            print_text(f"{MARKS[finding.ok]:<8}{finding.step.value}: {finding.sentence}")
            if finding.remedy:
                print_text(f"{'':<8}  {finding.remedy}")

        report = BringUp(robot, bench, operator, show, robot_file).run(wanted)
    if as_json:
        print_json(report)
    elif report.backup:
        print_line(f"{report.file} has what was found; {report.backup} is the file as it was")
    return report.is_good


def _open(robot_file: RobotFile, base: Path, connect: str | None) -> zenoh.Session:
    """A session of the team, so that an agent of the same name is found; a new one if there is no team yet."""
    settings = robot_file.zenoh
    if isinstance(settings.tls, TlsTable):
        os.environ[TLS_VARIABLE] = str(folder_of(base, settings.tls.folder).resolve())
    where = endpoints_of(settings, connect)
    if where and any(map(may_answer, where)):
        return open_session(mode="client", connect=where)
    interface = robot_file.parameters.get("mocdevice", {}).get("interface", ON_THE_WIRE[0])
    if connect is not None or ("mocdevice" not in robot_file.robot.roles and interface in ON_THE_WIRE):
        raise NobodyThere(
            f"nobody answers at {', '.join(where) or 'any endpoint'}, and the base is reached over it: "
            "start `robrain arena`, or set interface in [parameters.mocdevice]"
        )
    print_message("bringup: no team answers; going on without one. See that the robot's agent does not run")
    return open_lockstep_session()


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
