"""Removes the oldest recordings of a team before the disk is full."""

import logging
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from stat import S_ISREG
from typing import NamedTuple

from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive, PositiveInt

logger = logging.getLogger(__name__)

CHECK_NS = to_ns(10.0)
"""Period of the checks of the folder."""
YOUNG_S = 60.0
"""A file that changed so lately is never removed: another recorder may be writing it."""
FREE_BYTES = 500_000_000
"""Room that rotation keeps on the disk, whatever its other limits (chosen)."""


class KeepFiles(Checked, frozen=True, kw_only=True):
    """Which recordings stay; at least one of the two is given.

    Raises:
        ValueError: a limit is not above 0, or none is given.

    """

    size_bytes: PositiveInt | None = None
    """All files together, the one that is written included."""
    age_s: Positive | None = None
    """Since the last change of a file."""
    free_bytes: int = FREE_BYTES
    """Room that is kept on the disk."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size_bytes is None and self.age_s is None:
            raise ValueError("expected size_bytes or age_s")


class _File(NamedTuple):
    changed_ns: int
    path: Path
    size_bytes: int


class Rotation:
    """Keeps a folder's recordings within limits: whole files, the oldest first, never the one that is written.

    Args:
        folder: of the recordings.
        pattern: matches the whole names of files that may be removed; other files stay.
        keep: the limits.
        free_bytes: gives the free room on the folder's disk.

    """

    def __init__(
        self,
        folder: Path,
        pattern: re.Pattern[str],
        keep: KeepFiles,
        free_bytes: Callable[[Path], int] = lambda folder: shutil.disk_usage(folder).free,
    ) -> None:
        self._folder, self._pattern, self._keep, self._free_bytes = folder, pattern, keep, free_bytes
        self._check_ns: int | None = None
        self._warned = ""
        self.removed = 0
        """Files removed so far."""

    def step(self, now_ns: int, writing: Path) -> None:
        """Remove recordings that are too old or too large together, every 10 s.

        Args:
            now_ns: time of day, as stamps of files are.
            writing: the file that is written now.

        """
        if self._check_ns is not None and 0 <= now_ns - self._check_ns < CHECK_NS:
            return
        self._check_ns = now_ns
        try:
            self._rotate(now_ns, writing)
        except OSError as error:  # a recording continues without rotation; its disk reports its own errors
            self._warn(f"old recordings in {self._folder} cannot be removed: {error}")

    def _rotate(self, now_ns: int, writing: Path) -> None:
        files = sorted(self._files())
        size_bytes = sum(file.size_bytes for file in files)
        free_bytes = self._free_bytes(self._folder)
        for file in files:
            reason = self._reason(file, now_ns, size_bytes, free_bytes)
            if not reason:
                continue
            if file.path == writing or abs(now_ns - file.changed_ns) < YOUNG_S * NS_PER_S:
                continue
            file.path.unlink()
            logger.warning("recording %s was removed: %s", file.path.name, reason)
            self.removed += 1
            size_bytes -= file.size_bytes
            free_bytes += file.size_bytes
        if reason := self._reason(None, now_ns, size_bytes, free_bytes):
            self._warn(f"recordings in {self._folder}: {reason}, and nothing is left that may be removed")
        else:
            self._warned = ""

    def _files(self) -> list[_File]:
        paths = [path for path in self._folder.iterdir() if self._pattern.fullmatch(path.name)]
        states = [(path, path.lstat()) for path in paths]
        return [_File(state.st_mtime_ns, path, state.st_size) for path, state in states if S_ISREG(state.st_mode)]

    def _reason(self, file: _File | None, now_ns: int, size_bytes: int, free_bytes: int) -> str:
        keep = self._keep
        if file is not None and keep.age_s is not None and now_ns - file.changed_ns > keep.age_s * NS_PER_S:
            return f"it is older than {keep.age_s / 86400:g} days"
        if keep.size_bytes is not None and size_bytes > keep.size_bytes:
            return f"together they have {size_bytes / 1e9:.3g} GB, and {keep.size_bytes / 1e9:g} GB are kept"
        if free_bytes < keep.free_bytes:
            return f"the disk has {free_bytes / 1e9:.2g} GB left, and {keep.free_bytes / 1e9:g} GB are kept free"
        return ""

    def _warn(self, text: str) -> None:
        if text != self._warned:  # each text once in the log
            self._warned = text
            logger.warning("%s", text)


def own_recordings(path: Path, *, is_given: bool) -> re.Pattern[str]:
    """Names of the recordings that a recorder may remove: those of its series only.

    Args:
        path: of its recording.
        is_given: whether a person chose the name; else it is `TEAM-N.mcap`, and earlier numbers are of the series too.

    >>> bool(own_recordings(Path("runs/depot-7.mcap"), is_given=False).fullmatch("depot-6_0012.mcap"))
    True
    >>> bool(own_recordings(Path("runs/night.mcap"), is_given=True).fullmatch("night-watch.mcap"))
    False
    """
    stem = re.escape(path.stem)
    if not is_given:
        stem = re.escape(path.stem.rpartition("-")[0]) + r"-\d+"
    return re.compile(stem + r"(_\d{4,})?" + re.escape(path.suffix))
