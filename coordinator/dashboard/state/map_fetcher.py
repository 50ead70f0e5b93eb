"""Asks robots for the whole of their maps, on a thread of its own, so that a slow robot never holds up the drawing."""

import threading
from concurrent.futures import ThreadPoolExecutor

import zenoh

from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import CallError, NobodyThere
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import ROBOT_MAP, ROBOT_MAP_WHOLE

TIMEOUT_S = 1.0
ATTEMPTS = 3
PAUSE_S = 1.0
"""Between two attempts: a robot's token can be back before its queryables are."""
NOTHING_KNOWN = b"null"
"""The answer of a robot that has seen nothing yet."""


class MapFetcher:
    """Puts the answers into `inbox`, where they look like patches that were published."""

    def __init__(self, endpoint: Endpoint, inbox: Inbox) -> None:
        self._endpoint = endpoint
        self._inbox = inbox
        self._wanted: set[str] = set()
        self._stopping = threading.Event()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="robrain-whole-map")

    def fetch(self, robot: str) -> None:
        """Ask a robot soon, unless it stands in line already."""
        if robot not in self._wanted and not self._stopping.is_set():
            self._wanted.add(robot)
            self._pool.submit(self._fetch, robot)

    def close(self) -> None:
        """Ask no more; returns within a second or so when a robot is being waited for."""
        self._stopping.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _fetch(self, robot: str) -> None:
        self._wanted.discard(robot)
        for _ in range(ATTEMPTS):
            if self._stopping.is_set():
                return
            try:
                answer = self._endpoint.ask(ROBOT_MAP_WHOLE, timeout_s=TIMEOUT_S, robot=robot)
            except (CallError, NobodyThere, zenoh.ZError):
                self._stopping.wait(PAUSE_S)
                continue
            if answer is not None:
                whole = ROBOT_MAP.payloads.write(answer)
                self._inbox.append(ROBOT_MAP, ROBOT_MAP.key(self._endpoint.team, robot=robot), whole)
            return
