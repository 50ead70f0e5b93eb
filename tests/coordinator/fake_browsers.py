"""Browsers that come and go by hundreds: bare websockets that say what viser's page says first, and read what comes."""

import asyncio
import threading
from importlib.metadata import version

import msgspec
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException

PROTOCOL = f"viser-v{version('viser')}"
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (3.0, 3.0, 3.0),
    "fov": 0.8,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}


class FakeBrowsers:
    """So many browsers at a time, of which each reads a few messages, goes, and comes back, on a thread of their own.

    Args:
        port: where the dashboard is served, loopback.
        count: browsers at a time.
        visits: how often each comes.
        messages: it reads so many of them at the most, then goes.
        camera: what differs from `CAMERA`.
    """

    def __init__(self, port: int, count: int, visits: int, messages: int = 4, **camera: object) -> None:
        self.gone = 0
        """Visits that have ended."""
        self.heard = 0
        """Messages that have come."""
        self.errors: list[str] = []
        self._port, self._count, self._visits, self._messages = port, count, visits, messages
        self._camera = msgspec.msgpack.encode({**CAMERA, **camera})
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended = asyncio.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._all()), name="fake-browsers")

    def __enter__(self) -> "FakeBrowsers":
        self._thread.start()
        return self

    def __exit__(self, failed: object, *_: object) -> None:
        if failed is not None and self._loop is not None and self.there:
            self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join()

    @property
    def there(self) -> bool:
        """Whether any of them is still to come or to go."""
        return self._thread.is_alive()

    async def _all(self) -> None:
        self._loop = asyncio.get_running_loop()
        visits = asyncio.gather(*(self._one(number) for number in range(self._count)))
        ended = asyncio.create_task(self._ended.wait())
        await asyncio.wait([visits, ended], return_when=asyncio.FIRST_COMPLETED)
        ended.cancel()
        visits.cancel()

    async def _one(self, number: int) -> None:
        for visit in range(self._visits):
            try:
                async with connect(
                    f"ws://127.0.0.1:{self._port}", subprotocols=[PROTOCOL], proxy=None, max_size=None
                ) as connection:
                    await self._look(connection, self._messages - (number + visit) % 4)
            except (OSError, WebSocketException) as error:
                self.errors.append(str(error))
            self.gone += 1

    async def _look(self, connection: ClientConnection, messages: int) -> None:
        await connection.send(self._camera)
        for _ in range(messages):
            await connection.recv()
            self.heard += 1
