"""Any executable is a plugin by its manifest alone."""

import logging
import os
import signal
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from robrain.agent.event import Mailbox
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import run_agent
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.plugins.unit.program import Program, ProgramEnded, ProgramLate
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.model.checked import convert
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.session import open_session
from tests.patient_endpoint import PatientEndpoint
from tests.waiting import PATIENCE_S, has_ended, until

ECHO = "import sys\nfor line in sys.stdin: print(line.strip().upper(), flush=True)"


class Bench:
    """A program's plugin as its tag would run it, on the test's own thread."""

    def __init__(self, drive=Drive.LIVE, **parameters):
        self.mailbox = Mailbox(100_000)
        self.told = []
        env = SimpleNamespace(plugin="tool", wire=SimpleNamespace(drive=drive))
        self.plugin = Program(env, convert(parameters, Program.Parameters))
        self.plugin.printed.add(self.told.append, self.mailbox)

    def start(self):
        self.plugin.init()
        self.plugin.activate()
        return self.plugin

    def until(self, condition):
        """Step until it is so."""

        def step() -> None:
            self.plugin.step()
            self.mailbox.deliver()

        until(condition, step=step)


@pytest.fixture
def start():
    benches = []

    def start(code=ECHO, **parameters):
        parameters.setdefault("time_limit_s", PATIENCE_S)
        bench = Bench(command=[sys.executable, "-c", code], **parameters)
        benches.append(bench)
        bench.start()
        return bench

    yield start
    for bench in benches:
        bench.plugin.deactivate()


def test_one_line_in_one_line_out(start):
    bench = start()
    assert bench.plugin.send("hello") == "HELLO"
    assert bench.plugin.send("grüß") == "GRÜSS"
    assert bench.plugin.state().pid is not None
    assert bench.plugin.state().lines == 2


def test_a_program_that_does_not_answer_in_time_is_killed(start):
    bench = start("import sys\nfor line in sys.stdin: pass", time_limit_s=0.2)
    with pytest.raises(ProgramLate, match=r"tool did not answer within 0\.2 s and was killed") as caught:
        bench.plugin.send("hello")
    assert caught.value.code is ErrorCode.TIMEOUT
    with pytest.raises(ProgramEnded, match="SIGKILL"):
        bench.until(lambda: False)


def test_a_program_that_has_done_its_work_is_no_fault(start):
    bench = start("print('done')")
    bench.until(lambda: bench.plugin.state().why)
    assert bench.plugin.state().pid is None
    with pytest.raises(ProgramEnded, match=r"tool does not run: .* has ended with status 0"):
        bench.plugin.send("more")


def test_failure_is_the_plugins_fault(start):
    bench = start("import sys; sys.exit(3)")
    with pytest.raises(ProgramEnded, match="has ended with status 3"):
        bench.until(lambda: False)


@pytest.mark.parametrize("kill_on_halt", [True, False])
def test_emergency_halt_ends_it_if_asked_to(start, kill_on_halt):
    bench = start(kill_on_halt=kill_on_halt)
    pid = bench.plugin.state().pid
    bench.plugin.emergency_halt()
    if kill_on_halt:
        until(lambda: has_ended(pid))
        bench.until(lambda: bench.plugin.state().pid not in (None, pid))
    else:
        assert bench.plugin.state().pid == pid
    assert bench.plugin.send("again") == "AGAIN"


def test_stderr_is_logged_and_a_flood_of_it_is_counted(start, caplog):
    caplog.set_level(logging.INFO)
    start("import sys\nfor n in range(5000): print('oops', n, file=sys.stderr)")
    until(lambda: "were not logged" in caplog.text)
    assert "tool: oops 0" in caplog.text
    assert "more lines on stderr were not logged" in caplog.text
    assert sum("oops" in record.getMessage() for record in caplog.records) < 1000


def test_runs_leave_no_thread_and_no_descriptor(start):
    start().plugin.deactivate()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        bench = start()
        os.kill(bench.plugin.state().pid, signal.SIGKILL)
        bench.plugin.deactivate()
    until(lambda: not any(thread.name.endswith("-tool") for thread in threading.enumerate()))
    until(lambda: len(os.listdir("/proc/self/fd")) <= before)


def test_a_robot_has_two_programs_by_their_manifests_alone(tmp_path):
    for name, factor in (("double", 2), ("triple", 3)):
        code = f"while True: print(int(input()) * {factor}, flush=True)"
        (tmp_path / f"{name}.toml").write_text(
            '[plugin]\nclass = "robrain.plugins.unit.program:Program"\n'
            f"[parameters]\ncommand = {msgspec.json.encode([sys.executable, '-c', code]).decode()}\n"
            f"time_limit_s = {PATIENCE_S}\n[tag]\nhang_s = {PATIENCE_S}\n"
            'restart = "on-failure"\nbackoff_s = 0.01\n'
        )
    robot_file = RobotFile(robot=RobotTable("r1", places=[str(tmp_path)], load=["double", "triple"]))
    stop, ready = threading.Event(), threading.Event()
    with open_session(mode="peer", listen=["tcp/127.0.0.1:0"]) as session:
        host = AgentHost(robot_file, Path(), session, LiveClock(), Drive.LIVE)
        thread = threading.Thread(target=run_agent, args=(host, stop.is_set, ready.set))
        thread.start()
        operator = PatientEndpoint(session, "default", LiveClock(), Drive.LIVE)
        try:
            assert ready.wait(PATIENCE_S)

            def doubled() -> bytes | None:
                try:
                    return operator.ask(ROBOT_CALL, ["3"], robot="r1", plugin="double", function="send")
                except CallError:
                    return None

            answers = [
                operator.ask(ROBOT_CALL, ["7"], robot="r1", plugin=name, function="send")
                for name in ("double", "triple")
            ]
            with pytest.raises(CallError, match="takes one line at a time") as caught:
                operator.ask(ROBOT_CALL, ["7\n8"], robot="r1", plugin="double", function="send")
            with pytest.raises(CallError, match="has ended with status 1"):
                operator.ask(ROBOT_CALL, ["none"], robot="r1", plugin="double", function="send")
            until(lambda: doubled() == b'"6"')  # it was started again
        finally:
            stop.set()
            thread.join(PATIENCE_S)
            operator.close()
    assert answers == [b'"14"', b'"21"']
    assert caught.value.code is ErrorCode.BAD_ARGUMENTS
