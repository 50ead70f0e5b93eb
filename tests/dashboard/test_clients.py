"""Browsers that come and go while the picture changes do not affect others."""

import asyncio
import logging
import math
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial

import pytest
import websockets.asyncio.server

from robrain.dashboard import Dashboard
from robrain.dashboard.server.server import LocalServer, close_server, open_server
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.wire.endpoint import Endpoint
from tests.dashboard.fake_browsers import FakeBrowsers
from tests.dashboard.test_shown_team import patch, tell, tell_place
from tests.waiting import PATIENCE_S

BROWSERS, VISITS = 20, 2


@pytest.fixture
def hasty() -> Iterator[None]:
    """Switch threads as often as possible, to provoke races that are otherwise rare."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before_s)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """The server waits for its browsers, which are on this computer and may be held up: no time limit ends one."""
    serve = partial(websockets.asyncio.server.serve, open_timeout=None, ping_interval=None)
    monkeypatch.setattr(websockets.asyncio.server, "serve", serve)


@pytest.fixture
def server() -> Iterator[LocalServer]:
    server = open_server("127.0.0.1", 0)
    yield server
    close_server(server)


def test_waiting_browser_is_woken_only_on_the_servers_own_thread(server: LocalServer) -> None:
    buffer, loop = server._websock_server.get_message_buffer(), server.get_event_loop()
    loop.set_debug(True)  # reliably rejects calls from other threads
    waits = threading.Event()

    async def wait() -> int:
        buffer.message_event.clear()
        waits.set()
        await buffer.message_event.wait()
        return threading.get_ident()

    woken = asyncio.run_coroutine_threadsafe(wait(), loop)
    waits.wait()
    asyncio.run_coroutine_threadsafe(asyncio.sleep(0), loop).result()
    server.scene.add_frame("/new", show_axes=False)
    assert woken.result(PATIENCE_S) == server._websock_server._server_thread.ident


@pytest.mark.slow
@pytest.mark.usefixtures("hasty", "patient")
def test_no_layer_is_hidden_while_browsers_come_and_go(endpoint: Endpoint, caplog: pytest.LogCaptureFixture) -> None:
    dashboard = Dashboard(endpoint, port=0)
    failed: list[str] = []
    try:
        with FakeBrowsers(dashboard._server.get_port(), BROWSERS, VISITS) as browsers:
            step = 0
            while browsers.there:
                step += 1
                for robot in range(12):
                    tell_place(dashboard.view, f"r{robot}", math.sin(0.1 * step + robot), time.monotonic())
                dashboard.step(time.monotonic())
                failed += [layer.label for layer in dashboard._scene.layers if layer.failing]
        assert browsers.errors == []
        assert browsers.gone == BROWSERS * VISITS
    finally:
        dashboard.close()
    assert failed == []
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING] == []


@pytest.mark.slow
@pytest.mark.usefixtures("patient")
def test_browser_with_an_impossible_camera_ends_nothing_but_its_own_page(endpoint: Endpoint) -> None:
    cameras: list[dict[str, object]] = [
        {"image_width": 0, "image_height": -1},
        {"position": (math.nan, 0.0, 1.0)},
        {"position": (1.0, 1.0, 1.0), "look_at": (1.0, 1.0, 1.0), "up_direction": (0.0, 0.0, 0.0)},
    ]
    dashboard = Dashboard(endpoint, port=0)
    try:
        for camera in cameras:
            with FakeBrowsers(dashboard._server.get_port(), 1, 1, 9, **camera) as browsers:
                while browsers.there:
                    tell_place(dashboard.view, "r1", 0.0, time.monotonic())
                    tell(dashboard.view, ROBOT_MAP, patch([[0, 100]]), robot="r1")
                    dashboard.step(time.monotonic())
                    time.sleep(0.01)
            assert browsers.errors == []
            assert not [layer.label for layer in dashboard._scene.layers if layer.failing]
    finally:
        dashboard.close()
