"""A hub endpoint for one test process, so that no test meets another test's team or one running on the machine."""

import socket
from typing import Self


class OwnHub:
    """A port that stays bound without listening: a hub may listen there, but the system gives it to nobody else.

    Both sides set SO_REUSEADDR, as Zenoh does, so that a hub can still listen.
    """

    def __init__(self) -> None:
        self._holder = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._holder.bind(("127.0.0.1", 0))

    @property
    def port(self) -> int:
        return int(self._holder.getsockname()[1])

    @property
    def endpoint(self) -> str:
        return f"tcp/127.0.0.1:{self.port}"

    def close(self) -> None:
        self._holder.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
