"""What came into a recorded lockstep run from its script and from other processes, and how it is done again.

A query of the script is answered at once, between two ticks; one of another process waits for its component's step.
Zenoh delivers on the thread that sends, and an endpoint takes for another process what comes on another thread. So
what came from outside is sent again on a thread of its own, which is waited for.
"""

import threading
from collections import deque
from pathlib import Path
from typing import NamedTuple

import msgspec
import zenoh

from robrain.coordinator.recording.errors import RecordingError
from robrain.coordinator.recording.reader.reading import RecordedMessage, RecordingInfo, read_messages, topic_named_by
from robrain.protocol.wire.answers.lockstep_query import NO_LIMIT_S
from robrain.protocol.wire.clock import to_ns, to_seconds
from robrain.protocol.wire.messages.team.arena_messages import OutsideInput, ScriptInput
from robrain.protocol.wire.messages.team.team_messages import Halt
from robrain.protocol.wire.topic import JSON, Query, Topic
from robrain.protocol.wire.topics import ARENA_OUTSIDE, ARENA_SCRIPT, HALT, TOPICS
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.world.arena import TICK_S

INPUTS_MAX = 100_000
"""Inputs of one run that are repeated."""
INPUTS_BYTES = 256 * 1024 * 1024
"""Their payloads together."""
TICK_NS = to_ns(TICK_S)
_INPUT_TOPICS = (ARENA_SCRIPT, ARENA_OUTSIDE, HALT)


class RecordedInput(NamedTuple):
    """One input."""

    clock_ns: int
    """The run's clock when it came: between the tick of this time and the next."""
    from_script: bool
    is_query: bool
    key: str
    """Key, with the parameters of a query behind it."""
    payload: bytes


class RecordedInputs:
    """The inputs of a run, in order.

    Args:
        found: by time.
        not_repeated: inputs that cannot be done again: time in seconds and key.

    """

    def __init__(self, found: list[RecordedInput], not_repeated: list[tuple[float, str]]) -> None:
        self.not_repeated = not_repeated
        self.number = len(found)
        self._waiting = deque(found)

    def repeat(self, run: LockstepRun, now_ns: int) -> None:
        """Do again what came at this time of the run's clock, after its tick and before the next."""
        while self._waiting and self._waiting[0].clock_ns <= now_ns:
            wanted = self._waiting.popleft()
            if not wanted.from_script:
                _on_another_thread(run.session, wanted)
                continue
            if wanted.is_query:
                run.note_script(wanted.key, wanted.payload)
            _send(run.session, wanted)


def read_inputs(path: Path, info: RecordingInfo) -> RecordedInputs:
    """The inputs of a recorded run.

    Raises:
        RecordingError: the file is damaged, or has too many inputs.

    """
    if not any(topic_named_by(key) in _INPUT_TOPICS for key in info.counts):
        return RecordedInputs([], [])
    found: list[RecordedInput] = []
    not_repeated: list[tuple[float, str]] = []
    size = 0
    for message in read_messages(path):
        topic = topic_named_by(message.topic_key)
        if topic not in _INPUT_TOPICS:
            continue
        size += len(message.payload)
        if len(found) >= INPUTS_MAX or size > INPUTS_BYTES:
            raise RecordingError(
                path, f"{path} cannot be run again: it has more than {INPUTS_MAX} inputs, or more than "
                f"{INPUTS_BYTES // 1024**2} MiB of them"
            )  # fmt: skip
        try:
            read = _input(message, topic)
        except msgspec.DecodeError as error:
            raise RecordingError(path, f"{path} is damaged: {message.topic_key}: {error}") from error
        if read is not None:
            found.append(read)
        else:
            not_repeated.append((to_seconds(message.log_time_ns), message.topic_key))
    return RecordedInputs(sorted(found, key=lambda one: one.clock_ns), not_repeated)


def _input(message: RecordedMessage, topic: object) -> RecordedInput | None:
    log_ns = message.log_time_ns
    if topic is HALT:
        stamp_ns = msgspec.json.decode(message.payload, type=Halt).stamp_ns
        # A script puts between two ticks, and is stamped with the first; another process has another clock.
        from_script = stamp_ns in (log_ns - TICK_NS, log_ns)
        return RecordedInput(
            stamp_ns if from_script else log_ns - TICK_NS, from_script, False, message.topic_key, message.payload
        )
    if topic is ARENA_SCRIPT:
        script = msgspec.json.decode(message.payload, type=ScriptInput)
        return RecordedInput(script.stamp_ns, True, True, script.key, script.payload)
    outside = msgspec.json.decode(message.payload, type=OutsideInput)
    row = _row_of(outside.key)
    if row is None:
        return None
    return RecordedInput(outside.stamp_ns - TICK_NS, False, isinstance(row, Query), outside.key, outside.payload)


def _row_of(key: str) -> object:
    plain = key.partition("?")[0]
    return next((row for row in TOPICS if isinstance(row, Topic | Query) and row.parse(plain) is not None), None)


def _send(session: zenoh.Session, wanted: RecordedInput) -> None:
    if not wanted.is_query:
        session.put(wanted.key, wanted.payload)
        return
    ignored: zenoh.handlers.Callback[zenoh.Reply] = zenoh.handlers.Callback(lambda _: None, indirect=False)
    session.get(wanted.key, ignored, payload=wanted.payload or None, encoding=JSON, timeout=NO_LIMIT_S)


def _on_another_thread(session: zenoh.Session, wanted: RecordedInput) -> None:
    thread = threading.Thread(target=_send, args=(session, wanted), name="input-from-outside")
    thread.start()
    thread.join()
