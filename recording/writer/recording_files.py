"""The files of one recording: a single one, or several, when it is split or its disk was full for a while."""

import logging
import shutil
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from robrain.protocol.clock import to_ns
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive, PositiveInt
from robrain.recording.errors import RecordingError

if TYPE_CHECKING:
    from robrain.recording.writer.recording_file import RecordingFile

logger = logging.getLogger(__name__)

RETRY_NS = to_ns(5.0)
"""A recording whose disk failed tries to continue in its next file this often."""
ROOM_BYTES = 4 * 1024 * 1024
"""It does not try with less room than this: a file that ends after a moment is useless."""


class SplitAt(Checked, frozen=True, kw_only=True):
    """Limits at which a recording continues in its next file; none by default."""

    size_bytes: PositiveInt | None = None
    duration_s: Positive | None = None

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
        self.file = self._open(now_ns)
        """The present file."""
        self.paths = [self.file.path]
        """Every file so far."""

    @property
    def size_bytes(self) -> int:
        """Bytes in all files."""
        return self._closed_bytes + (self.file.size_bytes if self.file.path in self.paths else 0)

    @property
    def lost_by_topic(self) -> Counter[str]:
        """Messages of the wire that could not be written; also asked while it writes, on another thread."""
        return self._closed_lost.copy() + self.file.lost_by_topic.copy()

    def step(self, now_ns: int) -> bool:
        """Flush and split as it is due; returns whether a new file was begun."""
        self.file.flush_if_due(now_ns)
        if not (self.file.failure or self._is_full(now_ns)):
            return False
        if self.file.failure and self._retry_ns is None:
            self._retry_ns = now_ns
        if self._retry_ns is not None and 0 <= now_ns - self._retry_ns < RETRY_NS:
            return False
        if self._begin_next(now_ns):
            self._retry_ns = None
            return True
        self._retry_ns = now_ns
        return False

    def close(self) -> None:
        """Finish the last file."""
        self.file.close(self._end_metadata())

    def _end_metadata(self) -> dict[str, str]:
        part = {"part": str(self._parts), "part_messages": str(self.file.messages)} if self._parts else {}
        return {**self._summary(), **part}

    def _is_full(self, now_ns: int) -> bool:
        size, duration_s = self._split.size_bytes, self._split.duration_s
        if size is not None and self.file.size_bytes + self.file.held_bytes >= size:
            return True
        return duration_s is not None and now_ns - self.file.opened_ns >= to_ns(duration_s)

    def _begin_next(self, now_ns: int) -> bool:
        before = self.file
        if before.failure and shutil.disk_usage(self._path.parent).free < ROOM_BYTES:
            return False
        # A file that failed before its first message is useless, and gives its number to the next.
        useless = bool(before.failure) and not before.has_messages and self._parts > 1
        number = self._parts if useless else self._free_number(max(self._parts, 1) + 1)
        if useless and before.path in self.paths:
            self.paths.remove(before.path)
        try:
            following = self._open_part(number, now_ns)
        except RecordingError as error:
            if not before.failure:  # the old one continues; a full disk reports itself by it
                logger.warning("%s", error)
            return False
        if not before.failure:
            before.close(self._end_metadata())
        if not useless:
            self._closed_bytes += before.size_bytes
        self._closed_lost += before.lost_by_topic
        self.file, self._parts = following, number
        self.paths.append(following.path)
        if before.failure:
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
        description = {"part": str(number)}
        if lost:
            description["lost_before"] = msgspec.json.encode(lost).decode()
        return self._open_file(part_path(self._path, number), now_ns, description)
