"""Replay: says a recorded run again, under the same keys and at the same pace."""

import math
from pathlib import Path

from robrain.coordinator.recording.errors import RecordingError
from robrain.coordinator.recording.reading import read_messages, recording_info
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import BadName
from robrain.protocol.wire.publisher import Publisher
from robrain.protocol.wire.topic import Kind, Role
from robrain.protocol.wire.topics import COORDINATOR_ALIVE, ROBOT_ALIVE, topic_of


class Replay:
    """Puts the messages of a recording on the wire, byte for byte and in order, in the endpoint's team.

    Robots and coordinator of the recording are shown as being there for as long as the endpoint is open. Keys
    that are not of a recorded topic are left out. A recorded halt, and its end, is said again like all else: never
    replay into a team that has robots of its own.

    Args:
        endpoint: where to speak; its owner closes it.
        path: an MCAP file.
        speed: recorded seconds a second, over 0.
        loop: begin again at the end, for ever.

    Raises:
        RecordingError: the file or the speed cannot be used.
    """

    def __init__(self, endpoint: Endpoint, path: Path, speed: float = 1.0, loop: bool = False) -> None:
        if not (math.isfinite(speed) and speed > 0):
            raise RecordingError(path, f"cannot replay {path} at that speed: expected speed > 0, got {speed:g}")
        self.path = path
        self.info = recording_info(path)
        self._speed = speed
        self._loop = loop
        self._duration_ns = to_ns(self.info.duration_s)
        self._started_ns: int | None = None
        self._position_ns = 0
        self._messages = read_messages(path)
        self._next = next(self._messages, None)
        self._publishers = _publishers(endpoint, list(self.info.counts))

    @property
    def done(self) -> bool:
        """Whether all has been said; never, in a loop, unless there is nothing to say."""
        return self._next is None

    @property
    def progress(self) -> float:
        """How far it is, from 0 to 1; of the present round, in a loop."""
        if self.done:
            return 1.0
        return self._position_ns / self._duration_ns if self._duration_ns else 0.0

    def step(self, now_ns: int) -> int:
        """Put all that is due and return how many messages that was; time counts from the first step of a round.

        Raises:
            RecordingError: the file is damaged from here on.
        """
        if self._started_ns is None:
            self._started_ns = now_ns
        elapsed_ns = round((now_ns - self._started_ns) * self._speed)
        self._position_ns = min(max(elapsed_ns, 0), self._duration_ns)
        put = 0
        while self._next is not None and self._next.log_time_ns - self.info.start_ns <= elapsed_ns:
            message, self._next = self._next, None
            publisher = self._publishers.get(message.topic_key)
            if publisher is not None:
                publisher.put_bytes(message.payload)
                put += 1
            self._next = next(self._messages, None)
        if self._next is None and self._loop:
            # One round a step at the most, so that a file without length cannot hold its caller.
            self._begin_again()
        return put

    def close(self) -> None:
        """Let go of the file; `done` from then on."""
        self._loop = False
        self._next = None
        self._messages = iter(())

    def _begin_again(self) -> None:
        self._started_ns = None
        self._messages = read_messages(self.path)
        self._next = next(self._messages, None)


def _publishers(endpoint: Endpoint, keys: list[str]) -> dict[str, Publisher]:
    """A publisher for each recorded key that is of a topic of ours, and tokens for who spoke there."""
    publishers: dict[str, Publisher] = {}
    robots: set[str] = set()
    coordinator = False
    for key in keys:
        found = topic_of(key)
        if found is None:
            continue
        topic, names = found
        if not topic.recorded or topic.kind is not Kind.PUT:
            continue
        names = {field: names[field] for field in topic.fields}
        try:
            publishers[key] = endpoint.publisher(topic, **names)
        except BadName:
            continue
        if topic.by is Role.ROBOT and "robot" in names:
            robots.add(names["robot"])
        coordinator |= topic.by is Role.COORDINATOR
    for robot in sorted(robots):
        endpoint.token(ROBOT_ALIVE, robot=robot)
    if coordinator:
        endpoint.token(COORDINATOR_ALIVE)
    return publishers
