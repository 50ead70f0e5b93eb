"""Commands as a person types them: real processes, which are gone at the end of the test that started them."""

import io
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest
import zenoh

from robrain.protocol.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import HUB_VARIABLE
from robrain.protocol.wire.session import listening_at, open_session
from tests.own_hub import OwnHub
from tests.system.prefork import OWN_INTERPRETER, ForkedCommand, PreforkServer, end_with_parent, run_main
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parents[2]
PREFORK = PreforkServer()
GRACE_S = 30.0
"""Time for a process to end on request before it is killed."""


class Commands:
    """Runs `robrain` commands and ends them after the test.

    They find a team only at a given endpoint or at `hub`, which no other test's commands use. They are forked from a
    process that has imported robrain, except where a test sets a variable of the interpreter.

    A test whose subject is not the process uses `run_here`: it costs a tenth of a fork.

    Args:
        folder: that they run in.
        variables: of all of them and of the process that they are forked from, which is then not shared.

    """

    def __init__(self, folder: Path, **variables: str) -> None:
        self.folder = folder
        self._variables = variables
        self._server = PreforkServer(**variables) if variables else PREFORK
        self.hub = OwnHub()
        self._running: list[subprocess.Popen[str]] = []
        self._groups: set[int] = set()

    def run(self, *words: str, timeout_s: float = PATIENCE_S, **variables: str) -> subprocess.CompletedProcess[str]:
        if self._need_interpreter(variables):
            return self.run_python("-m", "robrain.cli", *words, timeout_s=timeout_s, **variables)
        process = self._fork(words, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, variables=variables)
        with process:
            try:
                stdout, stderr_text = process.communicate(timeout=timeout_s)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
        return subprocess.CompletedProcess(process.args, process.returncode, stdout, stderr_text)

    def run_here(self, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run a command in this process, with its own folder, environment, arguments, streams and log handlers."""
        assert not self._variables
        assert not self._need_interpreter(variables)
        streams = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(3)]
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        root, before = logging.getLogger(), Path.cwd()
        log_level, log_handlers = root.level, root.handlers[:]
        root.handlers.clear()
        os.chdir(self.folder)
        try:
            with ExitStack() as patches:
                patches.enter_context(patch.dict(os.environ, self._environment(variables), clear=True))
                patches.enter_context(patch.object(sys, "argv", [str(ROOT / "robrain" / "cli.py"), *words]))
                for name, stream in zip(("stdin", "stdout", "stderr"), streams, strict=True):
                    patches.enter_context(patch.object(sys, name, stream))
                status = run_main()
        finally:
            os.chdir(before)
            root.setLevel(log_level)
            root.handlers[:] = log_handlers
            for number, handler in handlers.items():
                signal.signal(number, handler)
        _, stdout, stderr = (stream.buffer.getvalue().decode() for stream in streams)
        return subprocess.CompletedProcess(["robrain", *words], status, stdout, stderr)

    def refused(self, *words: str, **variables: str) -> str:
        """The sentence with which a command refuses its words, and nothing else of it."""
        done = self.run_here(*words, **variables)
        assert (done.returncode, done.stdout) == (2, ""), done.stderr
        assert "Traceback" not in done.stderr
        (line,) = (line for line in done.stderr.splitlines() if line.startswith("robrain: "))
        return line

    def run_until(
        self, is_good: Callable[[subprocess.CompletedProcess[str]], object], *words: str, **variables: str
    ) -> subprocess.CompletedProcess[str]:
        """Run a command until its result is good, as a person would type it again.

        On an overloaded machine a robot may lose its link for a moment, or not answer in the time that a command gives.
        """
        run = self.run if self._variables or self._need_interpreter(variables) else self.run_here
        last: subprocess.CompletedProcess[str] | None = None
        deadline_s = time.monotonic() + PATIENCE_S
        while last is None or time.monotonic() < deadline_s:
            last = run(*words, **variables)
            if is_good(last):
                return last
        raise AssertionError(f"{' '.join(words)} ended with {last.returncode}: {last.stdout}{last.stderr}")

    def run_python(self, *words: str, timeout_s: float, **variables: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *words],
            cwd=self.folder,
            env=self._environment(variables),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )

    def start(
        self, *words: str, stdin: int | None = None, stderr: int = subprocess.STDOUT, **variables: str
    ) -> subprocess.Popen[str]:
        process: subprocess.Popen[str]
        if self._need_interpreter(variables):
            process = subprocess.Popen(
                [sys.executable, "-m", "robrain.cli", *words],
                cwd=self.folder,
                env=self._environment(variables),
                stdin=stdin,
                stdout=subprocess.PIPE,
                stderr=stderr,
                text=True,
                start_new_session=True,  # own process group, so that its leftovers can be ended with it
                preexec_fn=end_with_parent,
            )
        else:
            process = self._fork(words, stdin=stdin, stderr=stderr, variables=variables)
        self._groups.add(process.pid)
        self.adopt(process)
        return process

    def arena(self, *words: str) -> str:
        """Start an arena with a hub of its own, and files of its robots in this folder; its endpoint."""
        process = self.start("arena", *words, "--listen", "tcp/127.0.0.1:0", "--robot-files", ".")
        return self.line_with(process, "arena: ").split(" at ")[1].split(",")[0]

    def agents(self, *names: str, options: Sequence[str] = ()) -> "dict[str, subprocess.Popen[str]]":
        """Start the agents of robots whose files are here, and wait until they are up."""
        started = {name: self.start("agent", f"{name}.toml", *options) for name in names}
        for name, agent in started.items():
            self.line_with(agent, f"agent: {name} is up")
        return started

    def coordinator(self, endpoint: str, *words: str) -> "subprocess.Popen[str]":
        """Start a coordinator, and wait until it leads."""
        process = self.start("coordinator", "--connect", endpoint, *words)
        self.line_with(process, "coordinator: of team")
        return process

    def team(self, robots: int, *words: str) -> str:
        """Start arena, agents and coordinator; the endpoint."""
        endpoint = self.arena("arena_small", "--robots", str(robots), *words)
        self.agents(*(f"r{number}" for number in range(1, robots + 1)))
        self.coordinator(endpoint)
        return endpoint

    def adopt(self, process: subprocess.Popen[str]) -> None:
        """End this process, too, at the end of the test."""
        self._running.append(process)

    def stop_all(self) -> None:
        for process in reversed(self._running):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for process in reversed(self._running):
            try:
                process.wait(GRACE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.pid in self._groups:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
            for stream in (process.stdin, process.stdout, process.stderr):
                if stream is not None:
                    stream.close()
        if self._server is not PREFORK:
            self._server.close()
        self.hub.close()

    @staticmethod
    def line_with(process: subprocess.Popen[str], text: str) -> str:
        """Read a process's output up to the line that holds `text`."""
        assert process.stdout is not None
        seen = []
        for line in process.stdout:
            seen.append(line)
            if text in line:
                return line
        raise AssertionError(f"{text!r} never came; the process said: {''.join(seen)}")

    def _fork(
        self, words: Sequence[str], *, stdin: int | None, stderr: int, variables: dict[str, str]
    ) -> ForkedCommand:
        return ForkedCommand(
            self._server,
            words,
            cwd=self.folder,
            env=self._environment(variables),
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=stderr,
            start_new_session=True,
        )

    @staticmethod
    def _need_interpreter(variables: dict[str, str]) -> bool:
        return any(name.startswith(OWN_INTERPRETER) for name in variables)

    def _environment(self, variables: dict[str, str]) -> dict[str, str]:
        inherited = {key: value for key, value in os.environ.items() if not key.startswith("ROBRAIN_")}
        return {**inherited, HUB_VARIABLE: self.hub.endpoint, **self._variables, **variables}


@pytest.fixture(scope="session", autouse=True)
def _end_of_prefork_server() -> Iterator[None]:
    yield
    PREFORK.close()


@pytest.fixture
def commands(tmp_path: Path) -> Iterator[Commands]:
    found = Commands(tmp_path)
    yield found
    found.stop_all()


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """A browser that the tests of a module share, each with a window of its own."""
    from tests.system.browser import browser_process

    with browser_process() as found:
        yield found


@contextmanager
def member_at(endpoint: str, team: str = "default") -> Iterator[Endpoint]:
    """A member of a team, which hears and says what a test wants."""
    with (
        closing(open_session(connect=[endpoint], wait_s=PATIENCE_S)) as session,
        closing(Endpoint(session, team, LiveClock(), Drive.LIVE)) as wire,
    ):
        yield wire


def endpoint_of(hub: zenoh.Session) -> str:
    """Where a hub listens by TCP."""
    return next(endpoint for endpoint in listening_at(hub) if endpoint.startswith("tcp/"))


@pytest.fixture
def hub() -> Iterator[zenoh.Session]:
    """A hub of the test's own."""
    session = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
    yield session
    session.close()


@pytest.fixture
def wire(hub: zenoh.Session) -> Iterator[Endpoint]:
    """What a member of the hub's team hears and says."""
    wire = Endpoint(hub, "default", LiveClock(), Drive.LIVE)
    yield wire
    wire.close()
