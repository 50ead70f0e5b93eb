"""Browsers that hang: processes that stand still, and sockets that nobody reads."""

import os
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from urllib.parse import urlsplit

from websockets.sync.client import connect

LITTLE_BYTES = 4096


@contextmanager
def stopped(processes: list[int]) -> Iterator[None]:
    """Processes that stand still for as long as the block lasts."""
    for process in processes:
        os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        for process in processes:
            with suppress(ProcessLookupError):  # `robrain up` has ended it, as it was silent for too long
                os.kill(process, signal.SIGCONT)


@contextmanager
def unread_socket(url: str) -> Iterator[None]:
    """A page's connection with hardly any room, of which nothing is read: what is sent to it piles up at once."""
    place = urlsplit(url)
    raw = socket.socket()
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, LITTLE_BYTES)
    raw.connect((place.hostname, place.port))
    protocol = f"viser-v{version('viser')}"
    connection = connect(
        f"ws://{place.netloc}", sock=raw, subprotocols=[protocol], origin=url, max_queue=1, proxy=None,
    )  # type: ignore[arg-type]  # fmt: skip
    try:
        yield
    finally:
        raw.close()
        connection.socket.close()
