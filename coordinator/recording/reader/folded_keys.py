"""The keys of a recording as a list that can be read: many of one topic, such as a hundred tasks, are one line."""

from collections import defaultdict

import msgspec

from robrain.coordinator.recording.foxglove.visual_topics import is_visual
from robrain.coordinator.recording.reader.contents import KeyContents

FOLDED_ABOVE = 16
"""Keys of one topic that are told singly."""


def folded(keys: list[KeyContents]) -> list[KeyContents]:
    """Keys by name, those of the wire first; the many of one topic as one, `task/event/* (97 keys)`.

    Of those that are folded the longest silence is that of the key that was silent longest, and the rate is that of
    all together.
    """
    by_topic: defaultdict[str, list[KeyContents]] = defaultdict(list)
    for key in keys:
        by_topic[key.topic or key.key].append(key)
    lines: list[KeyContents] = []
    for together in by_topic.values():
        lines += [_one(together)] if len(together) > FOLDED_ABOVE else together
    return sorted(lines, key=lambda line: (is_visual(line.key), line.key))


def _one(keys: list[KeyContents]) -> KeyContents:
    chunks = zip(*(key.key.split("/") for key in keys), strict=False)
    name = "/".join(alike[0] if len(set(alike)) == 1 else "*" for alike in chunks)
    silent = max(keys, key=lambda key: key.longest_gap_s)
    first_s, last_s = min(key.first_s for key in keys), max(key.last_s for key in keys)
    messages = sum(key.messages for key in keys)
    return msgspec.structs.replace(
        silent,
        key=f"{name} ({len(keys)} keys)",
        messages=messages,
        bytes=sum(key.bytes for key in keys),
        first_s=first_s,
        last_s=last_s,
        rate_hz=(messages - 1) / (last_s - first_s) if last_s > first_s else 0.0,
        gaps=sum(key.gaps for key in keys),
        missing=sum(key.missing for key in keys),
    )
