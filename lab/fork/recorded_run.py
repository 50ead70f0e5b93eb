"""A recorded lockstep run, with the data that repeat it."""

import tempfile
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec
import zenoh

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.lab.fork.changes import Change, SetPolicy
from robrain.lab.fork.fork_result import repeatable
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.links.zenoh_link import NO_LIMIT_S
from robrain.protocol.messages.team.arena_messages import ARENA_OUTSIDE, ARENA_SCRIPT, OutsideInput, ScriptInput
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.table.topics import all_rows
from robrain.protocol.topic import JSON, Query, Topic
from robrain.protocol.workers import OwnedThread
from robrain.recording.errors import RecordingError
from robrain.recording.provenance import (
    MAP_ATTACHMENT,
    MAP_YAML_ATTACHMENT,
    SETUP_ATTACHMENT,
    Provenance,
    RunSetup,
    software_versions,
)
from robrain.recording.reader.reading import RecordingInfo, read_messages, recording_info
from robrain.recording.reader.recorded_message import RecordedMessage, topic_named_by
from robrain.sim.errors import ScenarioError
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.world import TICK_S

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
        """Repeat the inputs of this time of the run's clock, after its tick and before the next."""
        while self._waiting and self._waiting[0].clock_ns <= now_ns:
            wanted = self._waiting.popleft()
            if not wanted.from_script:
                OwnedThread("input-from-outside", _send, run.session, wanted).close()
                continue
            if wanted.is_query:
                run.record_script(wanted.key, wanted.payload)
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
    return next((row for row in all_rows() if isinstance(row, Topic | Query) and row.parse(plain) is not None), None)


def _send(session: zenoh.Session, wanted: RecordedInput) -> None:
    if not wanted.is_query:
        session.put(wanted.key, wanted.payload)
        return
    ignored: zenoh.handlers.Callback[zenoh.Reply] = zenoh.handlers.Callback(lambda _: None, indirect=False)
    session.get(wanted.key, ignored, payload=wanted.payload or None, encoding=JSON, timeout=NO_LIMIT_S)


@dataclass(frozen=True)
class RecordedRun:
    """A recorded run that can be made again."""

    path: Path
    info: RecordingInfo
    scenario: Scenario
    """As it was run; its map file, if it has one, exists while the run is open."""
    is_script: bool
    """Whether a script ran the team."""
    changes: tuple[Change, ...]
    """Changes of a fork, its parents' included."""
    inputs: RecordedInputs
    """Inputs of the script and of other processes."""

    @property
    def end_ns(self) -> int:
        """The run's clock at the last message."""
        return self.info.start_ns + round(self.info.duration_s * 1e9)

    def policy_at(self, at_s: float) -> PlanningPolicy:
        """The planning policy in force at a moment."""
        set_before = [one for one in self.changes if isinstance(one, SetPolicy) and one.at_s <= at_s]
        return max(set_before, key=lambda one: one.at_s).planning if set_before else self.scenario.planning

    @property
    def other_versions(self) -> list[str]:
        """Software that differs from that of the recording, a few words for each."""
        here = software_versions()
        made = self.info.versions
        return [
            f"{name} {made.get(name, 'none')}, here {here.get(name, 'none')}"
            for name in sorted(here.keys() | made.keys())
            if here.get(name) != made.get(name)
        ]


@contextmanager
def recorded_run(path: Path) -> Iterator[RecordedRun]:
    """A recorded run, open within the block.

    Raises:
        RecordingError: the file is no recording, or cannot be run again; the text gives the reason.

    """
    provenance, setup = repeatable(path)
    info = recording_info(path)
    if not info.messages:
        raise RecordingError(path, f"{path} cannot be run again: it has no messages")
    changes = _changes(path, setup)
    inputs = read_inputs(path, info)
    with tempfile.TemporaryDirectory(prefix="robrain-fork-") as folder:
        scenario = _scenario(path, Path(folder), provenance, setup)
        yield RecordedRun(path, info, scenario, setup.is_script, changes, inputs)


def _changes(path: Path, setup: RunSetup) -> tuple[Change, ...]:
    if not setup.fork:
        return ()
    try:
        return msgspec.json.decode(setup.fork["changes"], type=tuple[Change, ...])
    except (KeyError, msgspec.DecodeError) as error:
        raise RecordingError(
            path, f"{path} cannot be run again: the changes of the fork are damaged: {error}"
        ) from error


def _scenario(path: Path, folder: Path, provenance: Provenance, setup: RunSetup) -> Scenario:
    file = folder / SETUP_ATTACHMENT
    file.write_text(setup.toml, encoding="utf-8")
    if setup.map_yaml:
        (folder / MAP_YAML_ATTACHMENT).write_text(setup.map_yaml, encoding="utf-8")
        (folder / MAP_ATTACHMENT).write_bytes(provenance.map_png or b"")
    try:
        scenario = Scenario.from_file(file)
        if isinstance(scenario.floor, Path) and scenario.floor != folder / MAP_YAML_ATTACHMENT:
            raise ScenarioError(f"{file}: map.file: expected {MAP_YAML_ATTACHMENT}")
        scenario.plan()
    except ScenarioError as error:
        text = str(error).replace(f"{folder}/", "")
        raise RecordingError(path, f"{path} cannot be run again: {text}") from error
    return scenario.replace(toml=provenance.scenario_toml)
