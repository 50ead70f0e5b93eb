"""Set-up for all tests.

Timings fail no test, so hypothesis has no deadline and may be slow; in CI it always draws the same examples.

The end of a run reports how many tests were skipped for lack of the real maps.
System tests, which mostly wait, are spread among the others, which need the CPU.
Each test process has its own hub endpoint, at which nobody listens, so that no test meets a team by accident.
"""

import gc
import logging
import os
import signal
import threading
from collections.abc import Iterator

import pytest
import zenoh
from hypothesis import HealthCheck, settings

from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import LiveClock, VirtualClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import CONNECT_VARIABLE, HUB_VARIABLE
from robrain.protocol.wire.session import open_lockstep_session, open_session
from robrain.protocol.workers import OwnedThread
from tests.own_hub import OwnHub
from tests.real_maps import WHY_NOT

settings.register_profile(
    "robrain", deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize="CI" in os.environ
)
settings.load_profile("robrain")

# A shell starts what runs in the background with SIGINT ignored, and children inherit that: Ctrl-C could not be tested.
signal.signal(signal.SIGINT, signal.default_int_handler)


class ThreadFailures(logging.Handler):
    """Reports an error of an owned thread to pytest, which fails the test."""

    def emit(self, record: logging.LogRecord) -> None:
        """Report it."""
        if record.exc_info:
            threading.excepthook(threading.ExceptHookArgs((*record.exc_info, threading.current_thread())))


logging.getLogger(OwnedThread.__module__).addHandler(ThreadFailures())

_HUB = OwnHub()
os.environ.pop(CONNECT_VARIABLE, None)
os.environ[HUB_VARIABLE] = _HUB.endpoint


def pytest_unconfigure() -> None:
    """Give the port back."""
    _HUB.close()


def pytest_collection() -> None:
    """Collect without looking for garbage: a fifth of the time."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Do not look at what is collected again and again."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark system tests as slow, and spread their files evenly among all but the last fifth of the others."""
    for item in items:
        if item.get_closest_marker("system"):
            item.add_marker("slow")
    files: dict[str, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.nodeid.partition("::")[0], []).append(item)
    waiting = [name for name, inside in files.items() if any(one.get_closest_marker("system") for one in inside)]
    others = [name for name in files if name not in waiting]
    order = {name: 0.8 * (place + 0.5) / len(waiting) for place, name in enumerate(waiting)}
    order |= {name: place / len(others) for place, name in enumerate(others)}
    items[:] = [item for name in sorted(files, key=order.__getitem__) for item in files[name]]


@pytest.fixture(autouse=True)
def nothing_is_set_aside(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fail a test in which a component sets a record or stage aside that raised: it goes on, but that is a defect."""
    found: list[str] = []
    set_aside = RecordGuard._set_aside

    def note(guard: RecordGuard, topic: str, name: str, error: BaseException) -> None:
        found.append(f"{topic} {name}: {type(error).__name__}: {error}")
        set_aside(guard, topic, name, error)

    monkeypatch.setattr(RecordGuard, "_set_aside", note)
    yield
    if request.node.get_closest_marker("sets_aside") is None:
        assert found == []


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Report how many tests were skipped for lack of the real maps."""
    left_out = sum(WHY_NOT in str(report.longrepr) for report in terminalreporter.getreports("skipped"))
    if left_out:
        terminalreporter.section("real maps", sep="!", yellow=True, bold=True)
        terminalreporter.line(f"{left_out} tests were NOT RUN: {WHY_NOT}", yellow=True, bold=True)


@pytest.fixture(scope="module")
def session() -> Iterator[zenoh.Session]:
    """A session of a lockstep run, which the tests of a file share."""
    with open_lockstep_session() as session:
        yield session


@pytest.fixture(scope="module")
def hub() -> Iterator[zenoh.Session]:
    """A session at which others of a live team may join, which the tests of a file share."""
    with open_session(mode="router", listen=["tcp/127.0.0.1:0"]) as session:
        yield session


@pytest.fixture
def lockstep_session() -> Iterator[zenoh.Session]:
    """A session of the test's own."""
    with open_lockstep_session() as session:
        yield session


@pytest.fixture
def wire(lockstep_session: zenoh.Session) -> Iterator[Endpoint]:
    """An endpoint in lockstep on a session of the test's own."""
    endpoint = Endpoint(lockstep_session, "test", VirtualClock(), Drive.LOCKSTEP)
    yield endpoint
    endpoint.close()


@pytest.fixture
def endpoint() -> Iterator[Endpoint]:
    """A live endpoint with a router of its own, as a dashboard gets it."""
    session = open_session(mode="router", listen=("tcp/127.0.0.1:0",))
    endpoint = Endpoint(session, "default", LiveClock(), Drive.LIVE)
    yield endpoint
    endpoint.close()
    session.close()  # type: ignore[no-untyped-call]
