"""Making a whole file of one whose end is missing or that is damaged, and adding what others draw to one without."""

from collections.abc import Callable
from pathlib import Path

import msgspec

from robrain.coordinator.recording.foxglove.channels import FoxgloveChannels
from robrain.coordinator.recording.reader.recording_copy import RecordingCopy, copy_recording
from robrain.coordinator.recording.writer.provenance import RECOVERY_METADATA, VISUAL_METADATA


class Recovery(msgspec.Struct, frozen=True, kw_only=True):
    """What was saved of a recording."""

    source: Path
    path: Path
    messages: int
    bytes: int
    """Size of the new file."""
    was_truncated: bool
    damaged_chunks: int
    """Chunks in the middle that could not be read, and whose messages are lost."""
    undescribed: int
    """Messages of keys that were described in a damaged chunk only; they are lost as well."""
    unread_bytes: int
    """Bytes at the end of the source that could not be read."""


def recover(source: Path, path: Path, on_progress: Callable[[float], None] | None = None) -> Recovery:
    """Write all that can be read of `source` to a new file with index and summary; what was lost is in its metadata.

    Args:
        source: an MCAP file.
        path: a file that does not exist yet.
        on_progress: told the share of the source that has been read, 0 to 1.

    Raises:
        RecordingError: the source is no recording, or the new file exists or cannot be written; none is left then.
    """
    copy = copy_recording(source, path, metadata=_recovered, on_progress=on_progress)
    return Recovery(
        source=source,
        path=path,
        messages=copy.messages,
        bytes=path.stat().st_size,
        was_truncated=copy.truncated,
        damaged_chunks=copy.damaged_chunks,
        undescribed=copy.undescribed,
        unread_bytes=copy.unread_bytes,
    )


def with_visual(source: Path, path: Path, on_progress: Callable[[float], None] | None = None) -> int:
    """Write a copy of a recording with what Foxglove, Lichtblick and Rerun draw; returns how many messages that adds.

    Channels of that kind which the source has are made again.

    Args:
        source: an MCAP file.
        path: a file that does not exist yet.
        on_progress: told the share of the source that has been read, 0 to 1.

    Raises:
        RecordingError: the source is no recording, or the new file exists or cannot be written; none is left then.
    """
    copy = copy_recording(source, path, visual=FoxgloveChannels(), metadata=_drawn, on_progress=on_progress)
    return copy.visual_messages


def _recovered(copy: RecordingCopy) -> tuple[str, dict[str, str]]:
    return RECOVERY_METADATA, {
        "messages": str(copy.messages),
        "was_truncated": str(copy.truncated).lower(),
        "damaged_chunks": str(copy.damaged_chunks),
        "undescribed": str(copy.undescribed),
        "unread_bytes": str(copy.unread_bytes),
    }


def _drawn(copy: RecordingCopy) -> tuple[str, dict[str, str]]:
    return VISUAL_METADATA, {"messages": str(copy.visual_messages)}
