"""`robrain traces`: a team's tasks as traces, sent to an OpenTelemetry collector by OTLP over HTTP."""

import logging
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from urllib.parse import urlsplit

from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export import SpanExportResult
from opentelemetry.sdk.util.instrumentation import InstrumentationScope
from opentelemetry.trace import SpanContext, SpanKind, TraceFlags
from opentelemetry.trace.status import Status, StatusCode

from robrain.deploy.errors import UsageError
from robrain.deploy.observability.task_spans import TaskSpan, TaskSpans
from robrain.deploy.processes.live_process import LiveStop, live_endpoint, note, open_when_there, tell
from robrain.protocol.wire.answers.trace import trace_of
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import RobrainError
from robrain.protocol.wire.hub import team_endpoints
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.tasks.task_messages import TaskRequest
from robrain.protocol.wire.topics import TASK_EVENT, TASK_WHY

HEAR_S = 0.2
SEND_S = 2.0
"""A collector that does not answer for so long is tried again later."""
AGAIN_S = 5.0
ASK_S = 1.0
WAITING_MAX = 10_000
"""Spans that wait for the collector; the oldest are dropped and counted."""
BATCH = 200
SCOPE = InstrumentationScope("robrain")


class SpanSender:
    """Sends spans to a collector, and keeps them while it is away.

    Args:
        endpoint: of the collector, such as `http://127.0.0.1:4318`.
        team: name of the team.

    """

    def __init__(self, endpoint: str, team: str) -> None:
        logging.getLogger("opentelemetry").setLevel(logging.CRITICAL)  # `send` says what is wrong, once
        self.dropped = 0
        self.sent = 0
        self._waiting: deque[TaskSpan] = deque()
        self._resource = Resource({"service.name": "robrain", "robrain.team": team})
        self._exporter = OTLPSpanExporter(endpoint=f"{endpoint.rstrip('/')}/v1/traces", timeout=SEND_S)

    def add(self, spans: list[TaskSpan]) -> None:
        """Send these next."""
        self._waiting.extend(spans)
        while len(self._waiting) > WAITING_MAX:
            self._waiting.popleft()
            self.dropped += 1

    def send(self) -> bool:
        """Send what waits; False if the collector did not take it."""
        while self._waiting:
            batch = [self._waiting[number] for number in range(min(BATCH, len(self._waiting)))]
            if self._exporter.export([self._readable(span) for span in batch]) is not SpanExportResult.SUCCESS:
                return False
            for _ in batch:
                self._waiting.popleft()
            self.sent += len(batch)
        return True

    def close(self) -> None:
        """End the connection."""
        self._exporter.shutdown()  # type: ignore[no-untyped-call]

    def _readable(self, span: TaskSpan) -> ReadableSpan:
        return ReadableSpan(
            name=span.name,
            context=_context(span.trace, span.span),
            parent=_context(span.trace, span.parent) if span.parent else None,
            resource=self._resource,
            attributes=span.attributes,
            kind=SpanKind.INTERNAL,
            status=Status(StatusCode.ERROR, span.error) if span.error else Status(StatusCode.OK),
            start_time=span.start_ns,
            end_time=span.end_ns,
            instrumentation_scope=SCOPE,
        )


def _context(trace: str, span: str) -> SpanContext:
    return SpanContext(int(trace, 16), int(span, 16), is_remote=False, trace_flags=TraceFlags(TraceFlags.SAMPLED))


def check_collector(endpoint: str) -> str:
    """Return an endpoint of a collector (UsageError if it is none)."""
    parts = urlsplit(endpoint)
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.query or parts.fragment:
        raise UsageError(f"--otlp {endpoint}: expected http://HOST:PORT or https://HOST:PORT of a collector")
    return endpoint


def traces_command(connect: str | None, team: str, otlp: str) -> None:
    """Send a team's tasks to a collector until Ctrl-C; wait until the endpoint answers.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        otlp: endpoint of the collector.

    Raises:
        RobrainError: in one sentence.

    """
    check_collector(otlp)
    should_stop = LiveStop()
    session = open_when_there("traces", team_endpoints(connect), should_stop)
    if session is None:
        return
    with closing(session), live_endpoint(session, team) as wire, closing(SpanSender(otlp, team)) as sender:
        tell(f"traces: of team {team} to {otlp}")
        send_traces(wire, sender, should_stop)


def send_traces(wire: Endpoint, sender: SpanSender, should_stop: Callable[[], bool]) -> None:
    """Send what happens to tasks until `should_stop`, and then once more what waits."""
    spans, inbox, again_s, is_away = TaskSpans(), Inbox(every=True), 0.0, False
    wire.subscribe(inbox, TASK_EVENT)
    while not should_stop():
        for received in inbox.drain():
            event = received.message
            sender.add(spans.take(event, "" if spans.knows(event.task.id) else _trace(wire, event.task.id)))
        if time.monotonic() >= again_s:
            was_away, is_away = is_away, not sender.send()
            again_s = time.monotonic() + AGAIN_S if is_away else 0.0
            if is_away and not was_away:
                note("traces: the collector does not take them; they are kept and sent again")
        time.sleep(HEAR_S)
    sender.send()


def _trace(wire: Endpoint, task: str) -> str:
    """What the coordinator says; else the one that follows from the task's id."""
    try:
        return wire.ask(TASK_WHY, TaskRequest(id=task), timeout_s=ASK_S).trace or trace_of(wire.team, task)
    except RobrainError:
        return trace_of(wire.team, task)
