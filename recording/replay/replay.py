"""Replay: publishes a recorded run again, under the same keys, at any pace, from any place."""

from collections.abc import Iterable
from pathlib import Path

from robrain.protocol.errors import BadName, CallError, ErrorCode
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.messages.team.recorder_messages import REPLAY_CONTROL, ReplayRequest, ReplayStatus
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE
from robrain.protocol.table.topics import topic_of
from robrain.protocol.topic import Role
from robrain.protocol.wire.endpoint import Endpoint, Request, Serve
from robrain.recording.errors import RecordingError
from robrain.recording.reader.reading import recording_info
from robrain.recording.reader.recorded_message import RecordedMessage
from robrain.recording.replay.player import Player


class Replay:
    """Puts the messages of a recording on the wire, byte for byte and in order, in the endpoint's team.

    Robots and coordinator of the recording appear as present while the endpoint is open. Keys that are not of a
    recorded topic are left out. A recorded halt, and its end, is published again like all messages: never replay into a
    team that has robots.

    Args:
        endpoint: where to speak; its owner closes it.
        path: an MCAP file.
        speed: recorded seconds a second, over 0.
        loop: begin again at the end, for ever.

    Raises:
        RecordingError: the file or the speed cannot be used.
    """

    def __init__(self, endpoint: Endpoint, path: Path, speed: float = 1.0, loop: bool = False) -> None:
        self.path = path
        self.info = recording_info(path)
        self._loop = loop
        self._closed = False
        self.player = Player(path)
        """Where it is. Pause and continue with it; seek with `seek`, which also publishes the state at that place."""
        self.player.set_speed(speed)
        self.player.play()
        self._publishers = _publishers(endpoint, list(self.info.counts))
        endpoint.answer(REPLAY_CONTROL, self._control, serve=Serve.IN_STEP)
        self._endpoint = endpoint

    @property
    def done(self) -> bool:
        """Whether all messages have been published; never, in a loop, unless there are none."""
        return self._closed or (self.player.done and not (self._loop and self.info.messages))

    @property
    def progress(self) -> float:
        """Progress, from 0 to 1; of the current round, in a loop."""
        if self.done:
            return 1.0
        return self.player.position_s / self.player.duration_s if self.player.duration_s else 0.0

    def step(self, now_ns: int) -> int:
        """Put all that is due and return how many messages that was; time counts from the first step of a round.

        Raises:
            RecordingError: the file is damaged from here on.
        """
        if self._closed:
            return 0
        self._endpoint.serve()
        try:
            put = self._put(self.player.steps(now_ns))
        except RecordingError:
            self.close()
            raise
        if self.player.done and self._loop:
            # One round a step at the most, so that a file without length cannot hold its caller.
            self.player.rewind()
        return put

    def seek(self, t_s: float) -> int:
        """Go to `t_s`, publish the state at that time, the map too, and return the number of its messages.

        Raises:
            RecordingError: the file is damaged there.
        """
        return self._put(self.player.seek(t_s))

    def close(self) -> None:
        """Release the file; `done` from then on."""
        self._closed = True
        self.player.close()

    def _put(self, messages: Iterable[RecordedMessage]) -> int:
        put = 0
        for message in messages:
            publisher = self._publishers.get(message.topic_key)
            if publisher is not None:
                publisher.put_bytes(message.payload)
                put += 1
        return put

    def _control(self, request: Request[ReplayRequest]) -> ReplayStatus:
        """Answer a query to `replay/control`."""
        wanted = request.asked
        try:
            if wanted.speed is not None:
                self.player.set_speed(wanted.speed)
            if wanted.seek_s is not None:
                self.seek(wanted.seek_s)
            if wanted.playing is not None:
                self.player.play() if wanted.playing else self.player.pause()
        except RecordingError as error:
            raise CallError(ErrorCode.BAD_ARGUMENTS, str(error)) from error
        return self.status

    @property
    def status(self) -> ReplayStatus:
        """Its position, and whether it moves."""
        player = self.player
        return ReplayStatus(
            position_s=player.position_s, duration_s=player.duration_s, speed=player.speed, playing=player.playing
        )


def _publishers(endpoint: Endpoint, keys: list[str]) -> dict[str, Publisher]:
    """A publisher for each recorded key of a known topic, and tokens for its senders."""
    publishers: dict[str, Publisher] = {}
    robots: set[str] = set()
    coordinator = False
    for key in keys:
        found = topic_of(key)
        if found is None:
            continue
        topic, names = found
        if not topic.recorded:
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
