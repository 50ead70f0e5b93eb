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

from robrain.agent.errors import HardwareAbsent
from robrain.agent.event import Mailbox
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import run_agent
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.plugins.unit.program import BadLine, Program, ProgramAbsent, ProgramEnded, ProgramLate
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


def test_json_goes_in_and_comes_out_a_document_a_line(start):
    double = (
        "import json, sys\nfor line in sys.stdin: print('noise'); print(json.dumps(json.loads(line) * 2), flush=True)"
    )
    bench = start(double, input="json", output="json")
    assert bench.plugin.send('[1,\n "two"]') == '[1, "two", 1, "two"]'
    assert bench.plugin.state().lines_skipped == 1
    with pytest.raises(BadLine, match="tool takes JSON"):
        bench.plugin.send("{")


@pytest.mark.parametrize("text", ["two\nlines", "two\rlines", "x" * 65])
def test_what_is_no_line_is_not_given_to_it(start, text):
    bench = start(max_line_bytes=64)
    with pytest.raises(BadLine, match="tool takes"):
        bench.plugin.send(text)
    assert bench.plugin.send("x" * 64) == "X" * 64


def test_lines_that_are_too_long_are_left_out_and_cost_no_memory(start, caplog):
    code = "import sys\nfor _ in range(200): sys.stdout.write('x' * 100_000)\nprint('\\nshort', flush=True)\ninput()"
    bench = start(code, max_line_bytes=1000)
    bench.until(lambda: bench.told == ["short"])
    assert bench.plugin.state().lines_skipped == 1
    assert "ignored a line of more than 1000 bytes" in caplog.text


def test_a_program_that_does_not_answer_in_time_is_killed(start):
    bench = start("import sys\nfor line in sys.stdin: pass", time_limit_s=0.2)
    with pytest.raises(ProgramLate, match=r"tool did not answer within 0\.2 s and was killed") as caught:
        bench.plugin.send("hello")
    assert caught.value.code is ErrorCode.TIMEOUT
    with pytest.raises(ProgramEnded, match="SIGKILL"):
        bench.until(lambda: False)


def test_a_program_that_does_not_read_holds_nobody_up(start):
    bench = start("import time; time.sleep(60)", time_limit_s=0.2, max_line_bytes=1_000_000)
    with pytest.raises(ProgramLate, match="did not take a line"):
        bench.plugin.write_line("x" * 1_000_000)


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


def test_a_missing_executable_is_absent_hardware():
    bench = Bench(command=["no-such-program"])
    with pytest.raises(ProgramAbsent, match="no executable no-such-program: install it") as caught:
        bench.start()
    assert isinstance(caught.value, HardwareAbsent)


def test_in_lockstep_it_says_that_it_keeps_no_step():
    bench = Bench(Drive.LOCKSTEP, command=["cat"])
    with pytest.raises(Exception, match="programs run only in the live drive"):
        bench.start()


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
