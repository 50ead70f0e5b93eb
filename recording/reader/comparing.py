"""Where two recordings of runs begin to differ: the first message that is not the same in both."""

import json
from collections.abc import Callable, Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import msgspec

from robrain.protocol.clock import to_seconds
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.reader.reading import RecordedMessage, read_messages, topic_named_by

VALUE_SHOWN = 200
"""Characters of a value that are told."""
ENDED = "(the recording has ended)"


class Difference(msgspec.Struct, frozen=True, kw_only=True):
    """The first message in which two runs differ, seen from the first run; values as JSON, cut where long."""

    number: int
    """Of the message among those of the wire, counted from 0."""
    time_s: float
    """Since the first message of the run."""
    key: str
    topic: str
    """Name in the table of topics; empty for what is not ours."""
    what: str
    """`key`, `time`, `field`, `payload`, or `end` when one run ends before the other."""
    path: str
    """JSON path of the field, such as `$.pose.x_m`; empty unless `what` is `field`."""
    first: str
    second: str


def first_difference(
    one: Path, two: Path, on_progress: Callable[[float], None] | None = None
) -> tuple[Difference | None, int]:
    """The first message in which two runs differ, or None; and how many are the same before it.

    Compared are key, time of recording since the first message, and payload of what went over the wire. Sequence
    numbers and stamps are in the payload.

    Raises:
        RecordingError: a file cannot be read.
    """
    start_one: int | None = None
    start_two: int | None = None
    number = 0
    for first, second in zip_longest(_of_the_wire(one, on_progress), _of_the_wire(two)):
        if start_one is None and first is not None:
            start_one = first.log_time_ns
        if start_two is None and second is not None:
            start_two = second.log_time_ns
        difference = compare_messages(number, first, second, start_one or 0, start_two or 0)
        if difference is not None:
            return difference, number
        number += 1
    return None, number


def _of_the_wire(path: Path, on_progress: Callable[[float], None] | None = None) -> Iterator[RecordedMessage]:
    return (message for message in read_messages(path, on_progress) if not is_visual(message.topic_key))


def compare_messages(
    number: int, first: RecordedMessage | None, second: RecordedMessage | None, start_one: int = 0, start_two: int = 0
) -> Difference | None:
    """How two messages of the same number differ, or None.

    Args:
        number: of both in their runs.
        first: None if the first run has ended.
        second: None if the second has.
        start_one: the first run's clock from which times count, ns.
        start_two: the second's.

    """
    shown = first or second
    if shown is None:
        return None
    topic = topic_named_by(shown.topic_key)
    time_ns = first.log_time_ns - start_one if first is not None else shown.log_time_ns - start_two

    def difference(what: str, one: str, two: str, path: str = "") -> Difference:
        return Difference(
            number=number,
            time_s=to_seconds(time_ns),
            key=shown.topic_key,
            topic=topic.name if topic is not None else "",
            what=what,
            path=path,
            first=_cut(one),
            second=_cut(two),
        )

    if first is None or second is None:
        return difference(
            "end", ENDED if first is None else first.topic_key, ENDED if second is None else shown.topic_key
        )
    if first.topic_key != second.topic_key:
        return difference("key", first.topic_key, second.topic_key)
    if first.payload != second.payload:
        return _payload_difference(first, second, difference)
    second_ns = second.log_time_ns - start_two
    if time_ns != second_ns:
        return difference("time", f"{to_seconds(time_ns):.9f}", f"{to_seconds(second_ns):.9f}")
    return None


def _payload_difference(
    first: RecordedMessage, second: RecordedMessage, difference: Callable[..., Difference]
) -> Difference:
    try:
        one, two = msgspec.json.decode(first.payload), msgspec.json.decode(second.payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return difference("payload", repr(first.payload), repr(second.payload))
    found = differing_path(one, two)
    if found is None:  # the same values, written otherwise
        return difference("payload", repr(first.payload), repr(second.payload))
    path, value_one, value_two = found
    return difference("field", value_one, value_two, path)


def differing_path(one: Any, two: Any, path: str = "$") -> tuple[str, str, str] | None:
    """JSON path of the first difference of two decoded values, and both values as JSON; None when they are equal.

    >>> differing_path({"a": [1, {"b": 2}]}, {"a": [1, {"b": 3}]})
    ('$.a[1].b', '2', '3')
    >>> differing_path({"a": 1}, {"a": 1, "b": None})
    ('$.b', '(absent)', 'null')
    """
    if isinstance(one, dict) and isinstance(two, dict):
        for name in [*one, *(name for name in two if name not in one)]:
            here = f"{path}.{name}" if name.isidentifier() else f"{path}[{json.dumps(name)}]"
            if name not in one or name not in two:
                value_one, value_two = (_json(side[name]) if name in side else "(absent)" for side in (one, two))
                return here, value_one, value_two
            found = differing_path(one[name], two[name], here)
            if found is not None:
                return found
        return None
    if isinstance(one, list) and isinstance(two, list):
        for index, (item_one, item_two) in enumerate(zip(one, two, strict=False)):
            found = differing_path(item_one, item_two, f"{path}[{index}]")
            if found is not None:
                return found
        if len(one) != len(two):
            return f"{path}.length", str(len(one)), str(len(two))
        return None
    # True equals 1 in Python, and not in JSON.
    if type(one) is type(two) and one == two:
        return None
    return path, _json(one), _json(two)


def _json(value: Any) -> str:
    return msgspec.json.encode(value).decode()


def _cut(text: str) -> str:
    return text if len(text) <= VALUE_SHOWN else text[: VALUE_SHOWN - 1] + "…"
