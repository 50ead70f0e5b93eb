"""The files of one recording: a single one, or several, when it is split or its disk was full for a while."""

import logging
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from robrain.protocol.clock import to_ns
from robrain.protocol.table.topic import Topic
from robrain.recording.errors import RecordingError

if TYPE_CHECKING:
    from robrain.recording.foxglove.channels import VisualMessage
    from robrain.recording.writer.recording_file import RecordingFile, StampedMessage

logger = logging.getLogger(__name__)

RETRY_NS = to_ns(5.0)
"""A recording whose disk failed tries to continue in its next file this often."""
ROOM_BYTES = 4 * 1024 * 1024
"""It does not try with less room than this: a file that ends after a moment is useless."""


class SplitAt(msgspec.Struct, frozen=True, kw_only=True):
    """Limits at which a recording continues in its next file; none by default."""

    size_bytes: int | None = None
    duration_s: float | None = None

    def __post_init__(self) -> None:
        if self.size_bytes is not None and self.size_bytes < 1:
            raise ValueError(f"expected size_bytes >= 1, got {self.size_bytes}")
        if self.duration_s is not None and not self.duration_s > 0:
            raise ValueError(f"expected duration_s > 0, got {self.duration_s:g}")

    @property
    def splits(self) -> bool:
        """Whether there is more than one file."""
        return self.size_bytes is not None or self.duration_s is not None


def part_path(path: Path, number: int) -> Path:
    """The name of one file of a split recording.

    >>> part_path(Path("runs/depot.mcap"), 2).as_posix()
    'runs/depot_0002.mcap'
    """
    return path.with_name(f"{path.stem}_{number:04d}{path.suffix}")


OpenFile = Callable[[Path, int, Mapping[str, str] | None], "RecordingFile"]
"""Opens one file: its path, the run's clock, and its description if there are several."""


class RecordingFiles:
    """Writes a recording to its file or files. Each file has the metadata, keys and schemas of the whole recording.

    Args:
        path: path of the file, or the base of the files' names.
        open_file: opens one.
        now_ns: the run's clock.
        split: when to continue in the next file.
        summary: gives the data at the end of a file; called when it is closed.

    Raises:
        RecordingError: the first file cannot be written; then no file remains.
    """

    def __init__(
        self, path: Path, open_file: OpenFile, now_ns: int, split: SplitAt, summary: Callable[[], Mapping[str, str]]
    ) -> None:
        self._path = path
        self._open_file = open_file
        self._split = split
        self._summary = summary
        self._parts = 1 if split.splits else 0
        self._closed_bytes = 0
        self._closed_lost: Counter[str] = Counter()
        self._retry_ns: int | None = None
        self._file = self._open(now_ns)
        self.paths = [self._file.path]
        """Every file so far."""

    @property
    def size_bytes(self) -> int:
        """Bytes in all files."""
        return self._closed_bytes + (self._file.size_bytes if self._file.path in self.paths else 0)

    @property
    def lost_by_topic(self) -> Counter[str]:
        """Messages of the wire that could not be written; also asked while it writes, on another thread."""
        return self._closed_lost.copy() + self._file.lost_by_topic.copy()

    @property
    def why(self) -> str:
        """Reason why no messages are written now; empty while messages are written."""
        return self._file.why

    def write(self, told: Iterable["StampedMessage"], log_time_ns: int) -> None:
        """Add messages to the present file."""
        self._file.write(told, log_time_ns)

    def write_visual(self, visual: "VisualMessage", log_time_ns: int) -> None:
        """Add a derived message to the present file."""
        self._file.write_visual(visual, log_time_ns)

    def step(self, now_ns: int) -> bool:
        """Flush and split as it is due; returns whether a new file was begun."""
        self._file.flush_if_due(now_ns)
        if not (self._file.why or self._is_full(now_ns)):
            return False
        if self._file.why and self._retry_ns is None:
            self._retry_ns = now_ns
        if self._retry_ns is not None and 0 <= now_ns - self._retry_ns < RETRY_NS:
            return False
        if self._begin_next(now_ns):
            self._retry_ns = None
            return True
        self._retry_ns = now_ns
        return False

    def write_beside(self, topic: Topic[Any], key: str, payload: bytes, now_ns: int) -> None:
        """Add a message that was not on the wire to the present file."""
        self._file.write_beside(topic, key, payload, now_ns)

    def close(self) -> None:
        """Finish the last file."""
        self._file.close(self._said())

    def _said(self) -> dict[str, str]:
        part = {"part": str(self._parts), "part_messages": str(self._file.messages)} if self._parts else {}
        return {**self._summary(), **part}

    def _is_full(self, now_ns: int) -> bool:
        size, duration_s = self._split.size_bytes, self._split.duration_s
        if size is not None and self._file.size_bytes + self._file.held_bytes >= size:
            return True
        return duration_s is not None and now_ns - self._file.opened_ns >= to_ns(duration_s)

    def _begin_next(self, now_ns: int) -> bool:
        before = self._file
        if before.why and shutil.disk_usage(self._path.parent).free < ROOM_BYTES:
            return False
        # A file that failed before its first message is useless, and gives its number to the next.
        useless = bool(before.why) and not before.has_messages and self._parts > 1
        number = self._parts if useless else self._free_number(max(self._parts, 1) + 1)
        if useless and before.path in self.paths:
            self.paths.remove(before.path)
        try:
            following = self._open_part(number, now_ns)
        except RecordingError as error:
            if not before.why:  # the old one continues; a full disk reports itself by it
                logger.warning("%s", error)
            return False
        if not before.why:
            before.close(self._said())
        if not useless:
            self._closed_bytes += before.size_bytes
        self._closed_lost += before.lost_by_topic
        self._file, self._parts = following, number
        self.paths.append(following.path)
        if before.why:
            missing = self._closed_lost.total()
            logger.warning("recording continues in %s; %d messages before it are missing", following.path, missing)
        return True

    def _free_number(self, number: int) -> int:
        """The first number from `number` on that no file has: existing files are never overwritten."""
        while part_path(self._path, number).exists():
            number += 1
        return number

    def _open(self, now_ns: int) -> "RecordingFile":
        if not self._parts:
            return self._open_file(self._path, now_ns, None)
        path = part_path(self._path, self._parts)
        if path.exists():
            raise RecordingError(path, f"cannot record to {path}: it exists already; give another name or move it away")
        return self._open_part(self._parts, now_ns)

    def _open_part(self, number: int, now_ns: int) -> "RecordingFile":
        lost = self.lost_by_topic if number > 1 else Counter[str]()
        message_text = {"part": str(number)}
        if lost:
            message_text["lost_before"] = msgspec.json.encode(lost).decode()
        return self._open_file(part_path(self._path, number), now_ns, message_text)
