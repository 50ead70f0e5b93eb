"""Judges all invariants of a run, from a recording or while it runs.

    judging = Judging(surroundings)
    run.follow(judging.receive)      # or judging.handle(message, time_ns) with decoded messages
    …
    for ruling in judging.finish(): …

An invariant is a subclass of `InvariantJudge`, and its line in `JUDGES`.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.arena_messages import ArenaTruth
from robrain.protocol.messages.team.team_messages import Halt, TeamState
from robrain.protocol.messages.team.zone_messages import Zones
from robrain.protocol.topic import Topic
from robrain.recording.invariants.invariant import (
    UNKNOWN_SURROUNDINGS,
    InvariantJudge,
    InvariantState,
    Ruling,
    Surroundings,
)
from robrain.recording.invariants.robot_invariants import EnergyBalance, Halts, MutualWait, NotStranded, Walls
from robrain.recording.invariants.task_invariants import TaskAtOne, TaskKept, TaskOnce
from robrain.recording.invariants.zone_invariants import ZonesObeyed

JUDGES: tuple[type[InvariantJudge], ...] = (
    TaskKept,
    TaskAtOne,
    TaskOnce,
    NotStranded,
    Walls,
    Halts,
    EnergyBalance,
    MutualWait,
    ZonesObeyed,
)
"""One for each invariant, in the order in which they are shown."""


class Judging:
    """Judges the messages of one run, in the order in which they were recorded.

    Args:
        surroundings: data that the messages do not have; invariants that need them are not judged without.
        start_ns: the run's clock at its start, from which the times of breaches count.
        judges: of the invariants that are judged.

    """

    def __init__(
        self,
        surroundings: Surroundings = UNKNOWN_SURROUNDINGS,
        start_ns: int = 0,
        judges: Sequence[type[InvariantJudge]] = JUDGES,
    ) -> None:
        self._judges = [judge(surroundings, start_ns) for judge in judges]
        self._handlers: dict[type, list[Callable[[Any, int], None]]] = {
            RobotState: [judge.handle_state for judge in self._judges],
            TaskEvent: [judge.handle_event for judge in self._judges],
            TeamState: [judge.handle_summary for judge in self._judges],
            Halt: [judge.handle_halt for judge in self._judges],
            ArenaTruth: [judge.handle_truth for judge in self._judges],
            Zones: [judge.handle_zones for judge in self._judges],
        }

    def handle(self, message: Any, time_ns: int) -> None:
        """The next message, and the run's clock when it was recorded; most are of no interest."""
        for handler in self._handlers.get(type(message), ()):
            handler(message, time_ns)

    def receive(self, recorded: Sequence[tuple[Topic[Any], str, bytes, int, int]], now_ns: int) -> None:
        """Receive recorded messages: for `LockstepRun.follow`."""
        for topic, _, payload, _, _ in recorded:
            if topic.message in self._handlers:
                message = topic.payloads.read_if_valid(payload)
                if message is not None:  # else not of the team: its border refuses such as well
                    self.handle(message, now_ns)

    def finish(self) -> list[Ruling]:
        """Verdict on each invariant, in the order of the judges; to be called when the run has ended."""
        return [judge.ruling() for judge in self._judges]


def broken(rulings: Iterable[Ruling]) -> int:
    """Number of broken invariants."""
    return sum(ruling.state is InvariantState.BROKEN for ruling in rulings)
