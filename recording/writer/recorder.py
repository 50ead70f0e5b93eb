"""The recorder: writes all messages of a team's recorded topics, and keeps a digest of them."""

import hashlib
import logging
import re
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from robrain.protocol.border.border import Border
from robrain.protocol.clock import Clock, to_ns, to_seconds
from robrain.protocol.links.inbox import Inbox, Sample
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE
from robrain.protocol.messages.team.arena_messages import ARENA_OUTSIDE
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE, LostMessages, RecorderState
from robrain.protocol.refusals import Refusal, Refusals, most_refused
from robrain.protocol.table.topics import all_topics
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.workers import OwnedThread
from robrain.recording.drawing.recorded_map import KnownMap
from robrain.recording.errors import RecordingError
from robrain.recording.provenance import Provenance
from robrain.recording.writer.recording_files import RecordingFiles, SplitAt
from robrain.recording.writer.rotation import Rotation

if TYPE_CHECKING:
    from robrain.recording.foxglove.channels import FoxgloveChannels
    from robrain.recording.writer.recording_file import StampedMessage

AT_ONCE = 64
"""Messages joined for the digest: few enough that the joined bytes stay in the processor's cache."""

_STAMP_AND_PAYLOAD_LENGTH = struct.Struct("<QQ")


class RunDigest:
    """SHA-256 over key, stamp and payload of every message, in order."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()
        self._key_prefixes: dict[str, bytes] = {}

    def add(self, messages: Sequence[tuple[object, str, bytes, int, int]]) -> None:
        """Accept messages; their topics and numbers do not count."""
        for start in range(0, len(messages), AT_ONCE):
            self._digest.update(self._digested(islice(messages, start, start + AT_ONCE)))

    def hexdigest(self) -> str:
        """The digest so far."""
        return self._digest.hexdigest()

    def _digested(self, messages: Iterable[tuple[object, str, bytes, int, int]]) -> bytes:
        prefixes, pack = self._key_prefixes, _STAMP_AND_PAYLOAD_LENGTH.pack
        parts: list[bytes] = []
        for _, key, payload, stamp_ns, _ in messages:
            parts += (prefixes.get(key) or self._add_key(key), pack(stamp_ns, len(payload)), payload)
        return b"".join(parts)

    def _add_key(self, key: str) -> bytes:
        encoded = key.encode()
        prefix = self._key_prefixes[key] = len(encoded).to_bytes(8, "little") + encoded
        return prefix


logger = logging.getLogger(__name__)


STATE_NS = to_ns(1.0)
"""Period at which a live recorder publishes its state."""
SLOW_S = 1.0
"""A step that takes longer than this is reported."""
SLOW = "as the disk or the machine is too slow"


class RecorderReports:
    """Publishes the state of a recorder.

    In live operation a hanging disk is reported while it hangs, from a separate thread. In lockstep, where the run
    waits for the disk, it is reported afterwards.

    Args:
        states: endpoint that publishes it.
        clock: the recorder's clock.
        read_state: gives the recorder's current state, from any thread.
        live: whether other components continue while the recorder waits.
    """

    def __init__(self, states: Publisher, clock: Clock, read_state: Callable[[], RecorderState], *, live: bool) -> None:
        self._states = states
        self._clock = clock
        self._read_state = read_state
        self._lock = threading.Lock()
        self._lost_reported = 0
        self._published_ns: int | None = None
        self._began_ns = 0
        self._began_s: float | None = None
        """Start of the step that runs, by the monotonic clock."""
        self._closed = threading.Event()
        self._thread = OwnedThread("disk-watch", self._watch) if live else None

    def begin(self) -> None:
        """The recorder begins to write."""
        self._began_ns, self._began_s = self._clock.now_ns(), time.monotonic()

    def end(self, lost: int) -> None:
        """It has written; `lost` is the total number of lost messages."""
        self._began_s = None
        now_ns = self._clock.now_ns()
        duration_s = to_seconds(now_ns - self._began_ns)
        slow = duration_s > SLOW_S
        due = self._published_ns is None or now_ns - self._published_ns >= STATE_NS
        if slow:
            logger.warning("recording is slow: writing took %.1f s, %s", duration_s, SLOW)
        if (due and (self._thread is not None or lost > self._lost_reported)) or slow:
            self._published_ns = now_ns
            self._lost_reported = lost
            self._publish(f"writing took {duration_s:.1f} s, {SLOW}" if slow else "")

    def close(self) -> None:
        """Publish the last state."""
        self._closed.set()
        if self._thread is not None:
            self._thread.close()
        self._publish("")

    def _watch(self) -> None:
        """Report a step that lasts longer than `SLOW_S`, once each `SLOW_S`."""
        while not self._closed.wait(SLOW_S):
            began_s = self._began_s
            lasted_s = 0.0 if began_s is None else time.monotonic() - began_s
            if lasted_s > SLOW_S:
                if lasted_s < 2 * SLOW_S:  # once in the log, again and again on the wire
                    logger.warning("recording has written nothing for %.1f s, %s", lasted_s, SLOW)
                self._publish(f"nothing has been written for {lasted_s:.1f} s, {SLOW}")

    def _publish(self, problem: str) -> None:
        with self._lock:
            state = self._read_state()
            self._states.put(msgspec.structs.replace(state, why="; ".join(filter(None, (state.why, problem)))))


REFUSED_KINDS = 200
"""Published in its state: it receives every topic."""
INBOX_CAPACITY = 65536
INBOX_BYTES = 256 * 1024 * 1024
SEQUENCE_MASK = 0xFFFF_FFFF
"""MCAP's sequence numbers have 32 bits."""


OnRecorded = Callable[[Sequence["StampedMessage"], int], None]
"""Receives messages, and the run's clock when they were recorded, in ns."""


class RecordingSummary(msgspec.Struct, frozen=True):
    """The result of a recording."""

    messages: int
    """Received messages, all of them in the digest."""
    bytes: int
    """Size of the file; 0 without one."""
    digest: str
    outside: int
    """Messages that reached a lockstep run from another process: it cannot be repeated if there are any."""
    dropped: int
    """Messages that came faster than they were written, and are in neither file nor digest."""
    path: Path | None
    lost: int = 0
    """Messages in the digest that the disk did not accept."""
    lost_by_topic: dict[str, int] = {}
    """Both together, by the topic's name."""
    paths: list[Path] = []
    """Every file, where the recording is split; removed files are skipped."""
    removed: int = 0
    """Older files that made room."""


class Recorder:
    """Receives every recorded topic of a team, in order of arrival, and writes each message as it was on the wire.

    Two runs with the same messages, in the same order, have the same `digest`; with a file or without. A disk that is
    full, slow or hangs is reported in the log and on the wire (`recorder/R/state`). Lost messages are counted by topic;
    no other component waits for the recorder.

    Args:
        endpoint: endpoint of the team; its owner closes it, after the recorder.
        path: an MCAP file to write, or None for the digest alone.
        provenance: setup of the run.
        split: when to continue in a next file; never, if not given.
        visual: write channels for Foxglove and similar viewers beside it, derived from the recorded messages.
        rotation: removes older recordings, in live.

    Raises:
        RecordingError: the file cannot be written; then there is no declaration, and no file on the disk.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        path: Path | None,
        provenance: Provenance,
        *,
        split: SplitAt | None = None,
        visual: bool = False,
        rotation: Rotation | None = None,
    ) -> None:
        self._rotation = rotation
        self._clock = endpoint.clock
        self._refusals = Refusals(endpoint.clock)
        self._team = endpoint.team
        self._messages = 0
        self._outside_queries = 0
        self._inbox = RecorderInbox(INBOX_CAPACITY, INBOX_BYTES, Border(endpoint.clock, self._refusals))
        self._digest = RunDigest()
        self._listener: OnRecorded | None = None
        self._summary: RecordingSummary | None = None
        self._visual: FoxgloveChannels | None = None
        self._known_map = KnownMap()
        self._files = self._open(path, provenance, split, visual=visual) if path is not None else None
        self._name = "rec_" + re.sub(r"[^A-Za-z0-9_.\-]", "_", path.stem)[:60] if path is not None else ""
        if endpoint.member is not None and path is not None:  # the router lets it publish under this name alone
            self._name = endpoint.member.name
        for topic in all_topics():
            if topic.recorded:
                endpoint.subscribe(self._inbox, topic)
        self._reports: RecorderReports | None = None
        if path is not None:
            states = endpoint.publisher(RECORDER_STATE, recorder=self._name)
            live = endpoint.drive is Drive.LIVE
            self._reports = RecorderReports(states, self._clock, self._state, live=live)

    @property
    def refused(self) -> list[Refusal]:
        """Messages that break the contract of their topic, and are not recorded."""
        return self._refusals.counts()

    @property
    def messages(self) -> int:
        """Messages recorded so far."""
        return self._messages

    @property
    def outside(self) -> int:
        """Messages and queries of other processes with an influence on a lockstep run."""
        return self._inbox.outside + self._outside_queries

    @property
    def paths(self) -> list[Path]:
        """Its files so far."""
        return self._files.paths if self._files is not None else []

    @property
    def size_bytes(self) -> int:
        """Bytes in its files."""
        return self._files.size_bytes if self._files is not None else 0

    @property
    def lost(self) -> int:
        """Messages that are not, and will not be, in a file."""
        return sum(self._lost().values())

    @property
    def digest(self) -> str:
        """SHA-256 over key, stamp and payload of every message in order, as hex.

        When other processes had an influence on a lockstep run, `+outside:N` follows: N messages came from them.
        """
        outside = self.outside
        return self._digest.hexdigest() + (f"+outside:{outside}" if outside else "")

    def follow(self, on_recorded: OnRecorded) -> None:
        """Have a function called with the messages of each step, in order, and the run's clock; in place of another."""
        self._listener = on_recorded

    def ask_maps(self, endpoint: Endpoint, robots: Iterable[str]) -> None:
        """Make robots publish their whole map, for a recording that begins in mid-run.

        The answers are recorded as if they had been published under `robot/R/map`: patches have changes only.
        """
        for robot in robots:
            endpoint.ask_into(self._inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=robot)

    def step(self) -> None:
        """Record the messages that have arrived since the last step. After `close` it has no effect."""
        if self._summary is not None:
            return
        if self._reports is None:
            self._record()
            return
        self._reports.begin()
        try:
            self._record()
        finally:
            self._reports.end(self.lost)

    def close(self) -> RecordingSummary:
        """Record the remaining messages, finish the file and return the summary; a second call returns the same."""
        if self._summary is None:
            self._record()
            if self._files is not None:
                self._files.close()
            lost, paths = self._unwritten, self.paths
            if self._rotation is not None:
                paths = [path for path in paths if path.exists()]
            self._summary = RecordingSummary(
                messages=self._messages,
                bytes=self.size_bytes,
                digest=self.digest,
                outside=self.outside,
                dropped=self._inbox.dropped,
                path=paths[0] if paths else None,
                lost=lost.total(),
                lost_by_topic=dict(lost + self._inbox.dropped_by_topic),
                paths=paths,
                removed=self._rotation.removed if self._rotation is not None else 0,
            )
            if self._reports is not None:
                self._reports.close()
        return self._summary

    def _record(self) -> None:
        now_ns = self._clock.now_ns()
        files, visual = self._files, self._visual
        received = self._stamped(self._inbox.drain_samples(), now_ns)
        self._messages += len(received)
        self._digest.add(received)
        if received and self._listener is not None:
            self._listener(received, now_ns)
        if files is not None:
            files.file.write(received, now_ns)
            for topic, key, payload, _, _ in received:
                if visual is not None:
                    visual.handle(topic, key, payload)
                elif topic is ROBOT_MAP:
                    self._known_map.handle(payload)
            if visual is not None:
                self._draw(visual, files, now_ns)
            if files.step(now_ns):
                self._record_whole_map(files, now_ns)
                if visual is not None:
                    visual.restart()
            if self._rotation is not None:
                self._rotation.step(now_ns, files.paths[-1])

    def _record_whole_map(self, files: RecordingFiles, now_ns: int) -> None:
        """Make a new file begin with the whole map, so that it can be viewed alone."""
        key = ROBOT_MAP.key(self._team, robot=self._name)
        for patch in self._known_map.patches(self._name, now_ns):
            files.file.write_beside(ROBOT_MAP, key, msgspec.json.encode(patch), now_ns)

    def _draw(self, visual: "FoxgloveChannels", files: RecordingFiles, now_ns: int) -> None:
        try:
            for derived in visual.due(now_ns):
                files.file.write_visual(derived, now_ns)
        except (ValueError, TypeError, OverflowError):
            # An invalid message of a stranger cannot be drawn; it is recorded nevertheless, and can be drawn later.
            logger.exception("recording to %s goes on without what others draw", files.paths[-1])
            self._visual = None

    def _state(self) -> RecorderState:
        """How it does; also asked while it writes, on another thread."""
        assert self._files is not None
        lost = self._lost()  # before the sum, which is counted first: each reported loss also has words
        dropped = self._inbox.dropped
        too_fast = f"{dropped} messages came faster than they are written" if dropped else ""
        return RecorderState(
            recorder=self._name,
            file=self._files.paths[-1].name,
            messages=self._messages,
            bytes=self._files.size_bytes,
            lost=[LostMessages(topic, messages) for topic, messages in sorted(lost.items())],
            refused=most_refused(self._refusals, REFUSED_KINDS),
            waiting=len(self._inbox),
            why="; ".join(filter(None, (self._files.file.failure, too_fast))),
            closed=self._summary is not None,
            removed=self._rotation.removed if self._rotation is not None else msgspec.UNSET,
        )

    @property
    def _unwritten(self) -> Counter[str]:
        """Messages that the disk did not accept, by topic."""
        return self._files.lost_by_topic if self._files is not None else Counter()

    def _lost(self) -> dict[str, int]:
        return dict(self._unwritten + self._inbox.dropped_by_topic.copy())  # others count there meanwhile

    def _end_metadata(self) -> dict[str, str]:
        """The metadata at the end of a file."""
        metadata = {
            "messages": str(self._messages),
            "digest": self.digest,
            "outside": str(self.outside),
            "dropped": str(self._inbox.dropped),
            "lost": str(self._unwritten.total()),
        }
        lost = self._lost()
        return metadata | ({"lost_by_topic": msgspec.json.encode(lost).decode()} if lost else {})

    def _open(self, path: Path, provenance: Provenance, split: SplitAt | None, *, visual: bool) -> RecordingFiles:
        try:
            # A digest alone does not need mcap, which comes with an extra.
            from robrain.recording.writer.recording_file import RecordingFile

            if visual:
                from robrain.recording.foxglove.channels import FoxgloveChannels

                self._visual = FoxgloveChannels()
                self._known_map = self._visual.known_map
        except ModuleNotFoundError as error:
            raise RecordingError(
                path, f"cannot record to {path}: {error.name} is not installed; pip install 'robrain[team]'"
            ) from error
        return RecordingFiles(
            path,
            lambda part, now_ns, about: RecordingFile(part, provenance, now_ns, about),
            self._clock.now_ns(),
            split or SplitAt(),
            self._end_metadata,
        )

    def _stamped(self, samples: Iterable[Sample], now_ns: int) -> "list[StampedMessage]":
        """Messages that pass the border, with the sender's stamp and number; a message without a stamp was sent now."""
        read = self._inbox.border.read
        stamped = []
        topic: Any  # a Topic: it subscribes to no other type
        for topic, key, payload, shared in samples:
            received = shared[0] if shared else read(topic, key, payload)
            if received is None:
                self._inbox.refused += 1
                continue
            message = received.message
            stamp_ns, seq = (message.stamp_ns, message.seq) if topic.is_stamped else (0, 0)
            stamped.append((topic, key, payload, max(stamp_ns, 0) or now_ns, seq & SEQUENCE_MASK))
            if topic is ARENA_OUTSIDE:
                self._outside_queries += 1
        return stamped


class RecorderInbox(Inbox):
    """Keeps every message until the recorder's step. A message that arrives when it is full is dropped.

    Refusing the newest, where other inboxes let the oldest go, leaves a recording that breaks off at a known place
    and is whole before it.

    Args:
        capacity: messages held at the most.
        capacity_bytes: bytes of their payloads held at the most.
        border: as in `Inbox`.
    """

    def __init__(self, capacity: int, capacity_bytes: int, border: Border | None = None) -> None:
        super().__init__(capacity, every=True, border=border)
        self.capacity_bytes = capacity_bytes
        self.dropped_by_topic: Counter[str] = Counter()
        self._bytes = 0

    def add(self, sample: Sample) -> bool:
        """Accept a message, or count it as refused or dropped."""
        topic, key, payload, _ = sample
        self.received += 1
        if len(payload) > topic.payloads.max_bytes and not self.border.admits(topic, key, payload):
            self.refused += 1
            return False
        size = len(payload)
        if len(self._every) >= self.capacity or self._bytes + size > self.capacity_bytes:
            self.dropped += 1
            self.dropped_by_topic[topic.name] += 1
            return False
        self._bytes += size
        self._every.append(sample)
        self.has_some = True
        return True

    def drain_samples(self) -> list[Sample]:
        """Return all messages, in order of arrival, and clear the inbox."""
        samples = super().drain_samples()
        drained = 0  # summed first: messages that arrive during the sum count as well
        for sample in samples:
            drained += len(sample[2])
        self._bytes -= drained
        return samples
