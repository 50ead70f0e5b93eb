"""The plugin host: calls against what they are made of, loading, starting; beside each figure the bound to keep.

`python -m tests.bench.plugin_host serve FOLDER ENDPOINT` is the other process of the call benchmark.
"""

import contextlib
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import cast

import zenoh

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import run_agent
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.lab.bench.figure import Figure, at_least, at_most, timing
from robrain.protocol.clock import LiveClock
from robrain.protocol.messages.robots.host_messages import HOST_LOAD, LoadRequest
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.topic import JSON
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session, open_session

CALLS = 3000
"""Of each kind; interleaved."""
WARM_UP_CALLS = 300
INTERNAL_CALLS = 50_000
LOADS = 30
PLUGINS = 200
ECHO_KEY = "bench/echo"
ROBOT = "bench"
ARGUMENTS = b'["hello, world"]'

PLUGIN = '''
from typing import Protocol
from robrain.agent.plugin import Device, Unit, external

class EchoInterface(Protocol):
    def echo(self, text: str) -> str: ...

class Echo(Device):
    """Says what it is told."""
    interface = EchoInterface
    @external
    def echo(self, text: str) -> str:
        """The text."""
        return text

class Caller(Unit):
    def activate(self):
        self.echo = self.env.use("echo", EchoInterface)
'''


def measure() -> list[Figure]:
    """All figures of the plugin host."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "bench_plugins.py").write_text(PLUGIN)
        _manifest(place, "echo", "Echo", visibility='["*", "command"]')
        _manifest(place, "caller", "Caller", requires='["echo"]')
        return [*_external_calls(place), _internal_call(place), _load(place), *_start(place)]


def _manifest(place: Path, name: str, class_name: str, **tag: str) -> None:
    lines = ["[plugin]", f'class = "bench_plugins:{class_name}"', "[tag]"]
    lines += [f"{key} = {value}" for key, value in tag.items()]
    (place / f"{name}.toml").write_text("\n".join(lines) + "\n")


# -- external calls ---------------------------------------------------------------------------------------------


def _external_calls(place: Path) -> list[Figure]:
    """Two processes over TCP loopback: a call through the host, and a queryable that sends the payload back."""
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    command = [sys.executable, "-m", "tests.bench.plugin_host", "serve", str(place), endpoint]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        server.stdout.readline()
        session = open_session(connect=[endpoint])
        call_key = ROBOT_CALL.key("default", robot=ROBOT, plugin="echo", function="echo")
        try:
            through_host, raw = _interleaved_ms(session, call_key, ECHO_KEY)
        finally:
            session.close()
            assert server.stdin is not None
            server.stdin.close()
            server.wait(10)
    figures = []
    for name, quantile, bound in (("median", 0.5, 1.3), ("p99", 0.99, 1.5)):
        host_ms, raw_ms = _quantile(through_host, quantile), _quantile(raw, quantile)
        beside = f"{host_ms:.3f} ms; a raw queryable {raw_ms:.3f} ms"
        what = f"external call over a raw queryable, {name}"
        figures.append(timing(what, host_ms / raw_ms, "×", at_most(bound), beside))
    return figures


def _interleaved_ms(session: zenoh.Session, *keys: str) -> list[list[float]]:
    times: list[list[float]] = [[] for _ in keys]
    for number in range(WARM_UP_CALLS + CALLS):
        for key, measured in zip(keys, times, strict=True):
            started_s = time.perf_counter()
            replies = list(session.get(key, payload=ARGUMENTS, encoding=JSON))
            elapsed_ms = 1000.0 * (time.perf_counter() - started_s)
            assert len(replies) == 1
            assert replies[0].ok is not None, replies[0].err
            if number >= WARM_UP_CALLS:
                measured.append(elapsed_ms)
    return times


def _quantile(values: list[float], quantile: float) -> float:
    return statistics.quantiles(values, n=1000)[round(1000 * quantile) - 1]


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return cast(int, probe.getsockname()[1])


def serve(place: Path, endpoint: str) -> None:
    """A live robot with an echo plugin and, beside it on the same session, a raw queryable; until stdin ends."""
    session = open_session(mode="router", listen=[endpoint])

    def echo(query: zenoh.Query) -> None:
        with query:
            payload = query.payload.to_bytes() if query.payload is not None else b""
            query.reply(query.key_expr, payload, encoding=JSON)

    raw = session.declare_queryable(ECHO_KEY, echo)
    with _live(place, session, "echo"):
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        sys.stdin.read()
    raw.undeclare()
    session.close()


# -- inside one process -----------------------------------------------------------------------------------------


def _host(place: Path, session: zenoh.Session, *load: str) -> AgentHost:
    table = RobotTable(ROBOT, places=[str(place)], load=list(load))
    return AgentHost(RobotFile(robot=table), Path(), session, LiveClock(), Drive.LIVE)


@contextlib.contextmanager
def _live(place: Path, session: zenoh.Session, *load: str) -> Iterator[AgentHost]:
    host, stopping, ready = _host(place, session, *load), threading.Event(), threading.Event()
    thread = threading.Thread(target=run_agent, args=(host, stopping.is_set, ready.set))
    thread.start()
    ready.wait(10)
    try:
        yield host
    finally:
        stopping.set()
        thread.join()


def _internal_call(place: Path) -> Figure:
    session = open_lockstep_session()
    host = _host(place, session, "caller")
    host.start()
    handle = host.manager.get("caller").plugin.echo  # type: ignore[attr-defined]
    plugin = host.manager.get("echo").plugin

    def by_handle() -> None:
        handle.echo("hello")

    def plainly() -> None:
        plugin.echo("hello")  # type: ignore[attr-defined]

    handle_us, plain_us = _per_call_us(by_handle), _per_call_us(plainly)
    host.close()
    session.close()
    return timing("internal handle call", handle_us, "µs", at_most(3), f"plain method {plain_us:.2f} µs")


def _per_call_us(function: Callable[[], None]) -> float:
    rounds = []
    for _ in range(5):
        started_s = time.perf_counter()
        for _ in range(INTERNAL_CALLS // 5):
            function()
        rounds.append((time.perf_counter() - started_s) / (INTERNAL_CALLS // 5))
    return 1e6 * statistics.median(rounds)


def _load(place: Path) -> Figure:
    """Asked over the wire, of a live robot with the stock plugins' folder among its places."""
    session = open_lockstep_session()
    operator = Endpoint(session, "default", LiveClock(), Drive.LIVE)
    times_ms = []
    with _live(place, session, "echo"):
        for number in range(LOADS):
            name = f"fresh_{number}"
            (place / f"{name}.py").write_text(PLUGIN)
            (place / f"{name}.toml").write_text(f'[plugin]\nclass = "{name}:Echo"\n')
            started_s = time.perf_counter()
            operator.ask(HOST_LOAD, LoadRequest(plugin=name), robot=ROBOT)
            times_ms.append(1000.0 * (time.perf_counter() - started_s))
            (place / f"{name}.toml").unlink()
    operator.close()
    session.close()
    median_ms, worst_ms = statistics.median(times_ms), max(times_ms)
    return timing(
        f"load into a live robot, worst of {LOADS}", worst_ms, "ms", at_most(50), f"median {median_ms:.1f} ms"
    )


def _start(place: Path) -> list[Figure]:
    many = place / "many"
    many.mkdir()
    names = [f"p{number}" for number in range(PLUGINS)]
    (many / "bench_plugins.py").write_text(PLUGIN)
    for number, name in enumerate(names):
        requires = f'["{names[number - 1]}"]' if number % 2 else "[]"
        _manifest(many, name, "Echo" if number % 2 == 0 else "Idle", visibility='["*"]', requires=requires)
    with (many / "bench_plugins.py").open("a") as source:
        source.write("\nclass Idle(Unit):\n    pass\n")
    session = open_lockstep_session()
    started_s = time.perf_counter()
    with _live(many, session, *names) as host:
        elapsed_s = time.perf_counter() - started_s
        active = sum(tag.state == "active" for tag in host.manager.plugins.values())
    session.close()
    return [
        timing(f"start of {PLUGINS} plugins, live", elapsed_s, "s", at_most(2)),
        timing(f"start of {PLUGINS} plugins, live: active then", active, bound=at_least(PLUGINS)),
    ]


if __name__ == "__main__" and sys.argv[1:2] == ["serve"]:
    serve(Path(sys.argv[2]), sys.argv[3])
