"""Fake browsers by the hundred: bare websockets that send the opening messages of viser's page and read the answers."""

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
    """Runs `count` browsers on one thread; each reads a few messages, disconnects, and reconnects.

    Args:
        port: port of the dashboard on loopback.
        count: browsers at a time.
        visits: connections of each browser.
        messages: maximum number of messages read per visit.
        camera: values that override `CAMERA`.
    """

    def __init__(self, port: int, count: int, visits: int, messages: int = 4, **camera: object) -> None:
        self.gone = 0
        """Number of visits that have ended."""
        self.heard = 0
        """Number of messages received."""
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
        """Whether any visit is still to come or to end."""
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
                    f"ws://127.0.0.1:{self._port}",
                    subprotocols=[PROTOCOL],
                    proxy=None,
                    max_size=None,
                    open_timeout=None,  # how long anything takes is no matter
                    ping_interval=None,
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
