"""Judges all invariants of a run, from a recording or while it runs.

    judging = Judging(surroundings)
    run.follow(judging.hear)      # or judging.take(message, time_ns) with decoded messages
    …
    for ruling in judging.finish(): …

An invariant is a class like those beside this file, and its line in `JUDGES`.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from robrain.coordinator.recording.invariants.energy_balance import EnergyBalance
from robrain.coordinator.recording.invariants.findings import Ruling, Standing
from robrain.coordinator.recording.invariants.halts import Halts
from robrain.coordinator.recording.invariants.invariant_judge import NOWHERE, Handler, InvariantJudge, Surroundings
from robrain.coordinator.recording.invariants.stranded import NotStranded
from robrain.coordinator.recording.invariants.task_at_one import TaskAtOne
from robrain.coordinator.recording.invariants.task_kept import TaskKept
from robrain.coordinator.recording.invariants.task_once import TaskOnce
from robrain.coordinator.recording.invariants.walls import Walls
from robrain.protocol.wire.border.codec import BadPayload
from robrain.protocol.wire.topic import Topic

JUDGES: tuple[type[InvariantJudge], ...] = (TaskKept, TaskAtOne, TaskOnce, NotStranded, Walls, Halts, EnergyBalance)
"""One for each invariant, in the order in which they are shown."""


class Judging:
    """Judges the messages of one run, in the order in which they were recorded.

    Args:
        surroundings: what the messages do not tell; what needs it is not judged without.
        start_ns: the run's clock at its start, from which the times of findings count.
        judges: of the invariants that are judged.

    """

    def __init__(
        self,
        surroundings: Surroundings = NOWHERE,
        start_ns: int = 0,
        judges: Sequence[type[InvariantJudge]] = JUDGES,
    ) -> None:
        self._judges = [judge(surroundings, start_ns) for judge in judges]
        self._handlers: dict[type, list[Handler]] = {}
        for judge in self._judges:
            for kind, handler in judge.handlers().items():
                self._handlers.setdefault(kind, []).append(handler)

    def take(self, message: Any, time_ns: int) -> None:
        """The next message, and the run's clock when it was recorded; most are of no interest."""
        for handler in self._handlers.get(type(message), ()):
            handler(message, time_ns)

    def hear(self, heard: Sequence[tuple[Topic[Any], str, bytes, int, int]], now_ns: int) -> None:
        """What a recorder has heard: for `LockstepRun.follow`."""
        handlers = self._handlers
        for topic, _, payload, _, _ in heard:
            if topic.message in handlers:
                try:
                    message = topic.payloads.read(payload)
                except BadPayload:  # not of the team: its border refuses such as well
                    continue
                self.take(message, now_ns)

    def finish(self) -> list[Ruling]:
        """How each invariant stands, in the order of the judges; to be called when the run has ended."""
        return [judge.ruling() for judge in self._judges]


def judge(
    messages: Iterable[tuple[Any, int]],
    surroundings: Surroundings = NOWHERE,
    start_ns: int = 0,
) -> list[Ruling]:
    """Judge decoded messages, each with the run's clock when it was recorded."""
    judging = Judging(surroundings, start_ns)
    for message, time_ns in messages:
        judging.take(message, time_ns)
    return judging.finish()


def broken(rulings: Iterable[Ruling]) -> int:
    """How many invariants are broken."""
    return sum(ruling.standing is Standing.BROKEN for ruling in rulings)
