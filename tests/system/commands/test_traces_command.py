"""`robrain traces` sends the tasks of a live team to a collector, also what happened while that was away."""

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

from robrain import Team
from tests.waiting import until

pytestmark = pytest.mark.system


class Collector:
    """Takes OTLP over HTTP, or refuses it."""

    def __init__(self) -> None:
        self.is_away = False
        self.spans: dict[tuple[str, str], str] = {}
        """Trace of each span, by its task and name."""
        collector = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                if self.path == "/v1/traces" and not collector.is_away:
                    collector.take(ExportTraceServiceRequest.FromString(body))
                self.send_response(400 if collector.is_away else 200)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever)
        self._thread.start()
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"

    def take(self, request: ExportTraceServiceRequest) -> None:
        for of_resource in request.resource_spans:
            for of_scope in of_resource.scope_spans:
                for span in of_scope.spans:
                    said = {one.key: one.value.string_value for one in span.attributes}
                    self.spans[said["robrain.task"], span.name] = span.trace_id.hex()

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


@pytest.fixture
def collector() -> Iterator[Collector]:
    found = Collector()
    yield found
    found.close()


def test_tasks_of_a_live_team_come_to_a_collector_with_their_traces(commands, collector: Collector) -> None:
    arena = commands.start("arena", "arena_small", "--robots", "1", "--listen", "tcp/127.0.0.1:0", "--robot-files", ".")
    endpoint = commands.line_with(arena, "arena: arena_small at ").split(" at ")[1].split(",")[0]
    commands.line_with(commands.start("agent", "r1.toml"), "agent: r1 is up")
    commands.line_with(commands.start("coordinator", "--connect", endpoint), "coordinator: of team")
    traces = commands.start("traces", "--connect", endpoint, "--otlp", collector.url)
    commands.line_with(traces, "traces: of team default to http://127.0.0.1:")
    collector.is_away = True
    with Team.connect(endpoint) as client:
        until(lambda: "visit" in [one.kind for one in client.kinds()], "nobody visits")
        client.submit("visit", id="t1", place=(1.0, 1.0))
        trace = client.why("t1").trace
        client.wait("t1")
    commands.line_with(traces, "the collector does not take them; they are kept and sent again")
    assert collector.spans == {}
    collector.is_away = False
    until(lambda: ("t1", "task visit") in collector.spans, "the task never comes")
    of_task = {name: sent for (task, name), sent in collector.spans.items() if task == "t1"}
    assert {"queued", "running at r1", "task visit"} <= of_task.keys()
    assert set(of_task.values()) == {trace}


@pytest.mark.parametrize("otlp", ["127.0.0.1:4318", "ftp://x", "http://", "file:///etc/passwd"])
def test_what_is_no_collector_is_refused_in_words(commands, otlp: str) -> None:
    ended = commands.run("traces", "--otlp", otlp)
    assert ended.returncode == 2
    assert f"--otlp {otlp}: expected http://HOST:PORT or https://HOST:PORT of a collector" in ended.stderr
