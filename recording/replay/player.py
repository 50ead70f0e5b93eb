"""The player: a recording with access to any time. A replay page is built on it.

    player = Player(path)
    player.prepare()
    for message in player.seek(90.0):        # state at 90 s
        ...
    player.play()
    while playing:
        for message in player.step(clock.now_ns()):     # due
            ...
    player.close()

`seek` and `state_at` give the last message of each key before that time, found by the index of the file. A last map
patch alone is not the map: in its place they give patches that make up the merged map at that time.
"""

import logging
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import accumulate
from pathlib import Path

import msgspec

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.table.topics import topic_of
from robrain.recording.drawing.recorded_map import Place, RecordedMap, patches_of
from robrain.recording.errors import RecordingError
from robrain.recording.reader.chunked_file import ChunkedFile
from robrain.recording.reader.recorded_message import RecordedMessage

logger = logging.getLogger(__name__)

SELDOM = 256
"""A key with fewer messages than this is held in memory: the last one before a time may stand far before it."""
GAP_S = 60.0
"""Recorded time without a message that is played; more is passed over, as it is where a clock was set."""
HELD_BYTES_MAX = 64 * 1024 * 1024


class Player:
    """A recording with a position in it, which starts at the beginning and does not move until `play`.

    Times called `t_s` are seconds since the first message; times outside the recording are moved to its ends.

    Args:
        path: an MCAP file, also one without its end.

    Raises:
        RecordingError: there is no such file, it is no recording, or it is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = ChunkedFile(path)
        file = self._file
        self._counts: Counter[str] = Counter()
        """Messages of each key."""
        for channel in file.channels.values():
            self._counts[channel.topic] += file.counts.get(channel.id, 0)
        self.keys = sorted(+self._counts)
        """Keys that have a message."""
        self._map_keys = {key for key in self.keys if (found := topic_of(key)) is not None and found[0] is ROBOT_MAP}
        # The wall clock may have been set back in between; no message is due before earlier ones.
        self._ends_ns = list(accumulate((chunk.end_ns for chunk in file.chunks), max))
        self._key_chunks: dict[str, list[int]] = {key: [] for key in self.keys}
        for number, chunk in enumerate(file.chunks):
            for channel_id in chunk.channels:
                self._key_chunks[file.channels[channel_id].topic].append(number)
        self._map_chunks = sorted({number for key in self._map_keys for number in self._key_chunks[key]})
        self._maps = self._new_maps()
        self._held: dict[str, list[tuple[Place, RecordedMessage]]] = {}
        self._place: Place = (0, 0)
        self._position_ns = file.start_ns
        self._speed = 1.0
        self._played_from: tuple[int, int] | None = None
        """The caller's clock and the position at the start of playing; None when it stands or has not stepped yet."""
        self.playing = False

    # -- description ---------------------------------------------------------------------------------------

    @property
    def start_ns(self) -> int:
        """The run's clock at the first message."""
        return self._file.start_ns

    @property
    def duration_s(self) -> float:
        """From the first message to the last."""
        return to_seconds(self._file.end_ns - self._file.start_ns)

    @property
    def truncated(self) -> bool:
        """The end is missing; the rest can be played."""
        return self._file.truncated

    def prepare(self, on_message: Callable[[RecordedMessage], None] | None = None) -> None:
        """Read the file once, so that every later `seek` is quick; without it, `seek` is slow in a long recording.

        Args:
            on_message: called with each message.

        Raises:
            RecordingError: the file is damaged.
        """
        held: dict[str, list[tuple[Place, RecordedMessage]]] = {
            key: [] for key, count in self._counts.items() if count < SELDOM and key not in self._map_keys
        }
        self._maps = self._new_maps()
        held_bytes = 0
        for number in range(len(self._file.chunks)):
            for index, message in enumerate(self._file.read(number)):
                key = message.topic_key
                if on_message is not None:
                    on_message(message)
                if key in self._map_keys:
                    self._maps.handle(message.payload, (number, index))
                elif key in held:
                    held[key].append(((number, index), message))
                    held_bytes += len(message.payload)
                    if held_bytes > HELD_BYTES_MAX:  # maybe pictures: drop the largest messages
                        largest = max(held, key=lambda key: sum(len(kept.payload) for _, kept in held[key]))
                        held_bytes -= sum(len(kept.payload) for _, kept in held.pop(largest))
        self._held = held

    # -- the run at a time ----------------------------------------------------------------------------------

    def map_at(self, t_s: float) -> OccupancyGrid | None:
        """The map that all patches until `t_s` make up; None before the first."""
        atlas = self._maps.atlas_at(self._place_after(self._ns_of(t_s)))
        return None if atlas is None else atlas.grid

    # -- playing --------------------------------------------------------------------------------------------

    @property
    def position_s(self) -> float:
        """Where it is."""
        return to_seconds(self._position_ns - self._file.start_ns)

    @property
    def speed(self) -> float:
        """Recorded seconds a second."""
        return self._speed

    @property
    def done(self) -> bool:
        """Whether the last message has been given out."""
        return self._place[0] >= len(self._file.chunks)

    def seek(self, t_s: float) -> list[RecordedMessage]:
        """Go to `t_s`; it continues playing if it was.

        Returns the run as it was then: the last message of each key until then, and the map, in the order of the file.

        Raises:
            RecordingError: the file is damaged there.
        """
        self._position_ns = self._ns_of(t_s)
        self._played_from = None
        self._place = self._place_after(self._position_ns)
        return self._state_before(self._place, self._position_ns)

    def rewind(self) -> None:
        """Go back to before the first message; it continues playing if it was."""
        self._place = (0, 0)
        self._position_ns = self._file.start_ns
        self._played_from = None

    def play(self) -> None:
        """Move on with every step from now on."""
        self.playing = True
        self._played_from = None

    def set_speed(self, speed: float) -> None:
        """Play at this speed from now on, if it plays.

        Raises:
            RecordingError: the speed is not above 0.

        """
        if not 0 < speed < float("inf"):
            raise RecordingError(self.path, f"cannot replay {self.path} at that speed: expected speed > 0")
        self._speed = speed
        self._played_from = None

    def pause(self) -> None:
        """Stay where it is until `play`."""
        self.playing = False
        self._played_from = None

    def step(self, now_ns: int) -> list[RecordedMessage]:
        """Return the messages that are due by the caller's clock; none while it is paused.

        Raises:
            RecordingError: the file is damaged from here on.
        """
        return list(self.steps(now_ns))

    def steps(self, now_ns: int) -> Iterator[RecordedMessage]:
        """The same, one by one: messages before a damage come before its RecordingError."""
        if self.playing:
            if self._played_from is None:
                self._played_from = (now_ns, self._position_ns)
            self._pass_over_gap(now_ns)
            started_ns, from_ns = self._played_from
            due_ns = from_ns + round(max(now_ns - started_ns, 0) * self._speed)
            yield from self._advance_to(min(due_ns, self._file.end_ns))

    def step_by(self, duration_s: float) -> list[RecordedMessage]:
        """Advance by a recorded duration, playing or not, and return the messages of that time."""
        if duration_s < 0:
            raise ValueError(f"expected duration_s >= 0, got {duration_s:g}; seek goes back")
        self._played_from = None
        return list(self._advance_to(min(self._position_ns + to_ns(duration_s), self._file.end_ns)))

    def close(self) -> None:
        """Release the messages in memory; there is no file to close."""
        self.pause()
        self._held.clear()

    # -- places ---------------------------------------------------------------------------------------------

    def _ns_of(self, t_s: float) -> int:
        start_ns, end_ns = self._file.start_ns, self._file.end_ns
        return min(max(start_ns + to_ns(t_s), start_ns), end_ns)

    def _place_after(self, at_ns: int) -> Place:
        """The first message that is not due at `at_ns`."""
        number = bisect_left(self._ends_ns, at_ns + 1)
        if number >= len(self._ends_ns):
            return (number, 0)
        messages = self._file.read(number)
        return (number, next((i for i, message in enumerate(messages) if message.log_time_ns > at_ns), 0))

    def _pass_over_gap(self, now_ns: int) -> None:
        """Go to the next message if there is a long gap before it, or the clock was set back by much."""
        number, index = self._place
        messages = self._file.read(number) if number < len(self._file.chunks) else []
        gap_ns = messages[index].log_time_ns - self._position_ns if index < len(messages) else 0
        if abs(gap_ns) > to_ns(GAP_S):
            gap_s = to_seconds(abs(gap_ns))
            passed = f"nothing is recorded for {gap_s:.0f} s: passed over"
            what = passed if gap_ns > 0 else f"the clock was set back by {gap_s:.0f} s"
            logger.warning("%s: after %.1f s %s", self.path, self.position_s, what)
            self._position_ns += gap_ns
            self._played_from = (now_ns, self._position_ns)

    def _advance_to(self, due_ns: int) -> Iterator[RecordedMessage]:
        number, index = self._place
        from_ns = 0
        while number < len(self._file.chunks):
            messages = self._file.read(number)
            while index < len(messages) and from_ns <= messages[index].log_time_ns <= due_ns:
                from_ns = messages[index].log_time_ns - to_ns(GAP_S)
                index += 1
                self._place = (number, index)
                yield messages[index - 1]
            if index < len(messages):
                break
            number, index = number + 1, 0
            self._place = (number, index)
        self._position_ns = max(self._position_ns, due_ns)

    def _state_before(self, place: Place, at_ns: int) -> list[RecordedMessage]:
        found: dict[str, tuple[Place, RecordedMessage]] = {}
        # Keys by the last chunk, up to the place's own, in which they occur.
        wanted: dict[int, set[str]] = {}
        for key, chunks in self._key_chunks.items():
            if key in self._held:
                held = self._held[key]
                at = bisect_left(held, place, key=lambda entry: entry[0])
                if at:
                    found[key] = held[at - 1]
            elif key not in self._map_keys and (at := bisect_left(chunks, place[0] + 1)):
                wanted.setdefault(chunks[at - 1], set()).add(key)
        while wanted:
            number = max(wanted)
            keys = wanted.pop(number)
            messages = self._file.read(number)[: place[1] if number == place[0] else None]
            for index in range(len(messages) - 1, -1, -1):
                if messages[index].topic_key in keys:
                    found.setdefault(messages[index].topic_key, ((number, index), messages[index]))
            for key in keys - found.keys():  # it stands in the place's chunk, but behind it
                at = bisect_left(self._key_chunks[key], number)
                if at:
                    wanted.setdefault(self._key_chunks[key][at - 1], set()).add(key)
        ordered = [message for _, message in sorted(found.values(), key=lambda entry: entry[0])]
        return self._map_messages(place, at_ns) + ordered

    def _map_messages(self, place: Place, at_ns: int) -> list[RecordedMessage]:
        key = min(self._map_keys, default="")
        if not key:
            return []
        atlas = self._maps.atlas_at(place)
        if atlas is None:
            return []
        found = topic_of(key)
        robot = found[1]["robot"] if found is not None else ""
        patches = patches_of(robot, atlas, at_ns)
        return [RecordedMessage(key, at_ns, msgspec.json.encode(patch), "json", at_ns) for patch in patches]

    def _new_maps(self) -> RecordedMap:
        return RecordedMap(self._read_patches, sum(self._counts[key] for key in self._map_keys))

    def _read_patches(self, start: Place, end: Place) -> Iterator[bytes]:
        for number in self._map_chunks[bisect_left(self._map_chunks, start[0]) :]:
            if (number, 0) >= end:
                break
            for index, message in enumerate(self._file.read(number)):
                if message.topic_key in self._map_keys and start <= (number, index) < end:
                    yield message.payload
