"""Shrinks a failing fault script to the few faults and tasks that it needs.

Delta debugging (`ddmin`) over the list of faults, halts, cancellations and tasks; then over robots; then each remaining
fault is made as short as possible. Source: Zeller and Hildebrandt: Simplifying and Isolating Failure-Inducing Input,
IEEE Transactions on Software Engineering 28(2), 2002. A smaller script counts if it breaks the same invariant.
"""

from collections.abc import Callable, Collection, Sequence
from typing import TypeVar

import msgspec

from robrain.lab.soak.fault_script import CancelOrder, FaultScript, HaltOrder, TaskInput
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec

TRIALS_MAX = 300
"""Trials for one script, unless the caller sets a number."""
SHORTEST_S = 0.2
"""Faults are not made shorter than this."""

Part = FaultSpec | HaltOrder | CancelOrder | TaskInput
P = TypeVar("P")
Fails = Callable[[FaultScript], bool]


class Shrinker:
    """Shrinks one script.

    Args:
        fails: whether a script still breaks the invariant.
        trials_max: largest number of calls of `fails`.

    """

    def __init__(self, fails: Fails, trials_max: int = TRIALS_MAX) -> None:
        self.trials = 0
        """Number of its calls."""
        self._fails = fails
        self._trials_max = trials_max

    def shrink(self, script: FaultScript) -> FaultScript:
        """The smallest script that was found; the same one if none smaller fails."""
        parts = self._minimise(_parts(script), lambda kept: with_parts(script, kept))
        script = with_parts(script, parts)
        robots = self._minimise(list(script.robots), lambda kept: _with_robots(script, kept), least=1)
        script = _with_robots(script, robots) or script
        return self._shorten(script)

    def _minimise(self, items: list[P], build: Callable[[Sequence[P]], FaultScript | None], least: int = 0) -> list[P]:
        """A subset of items of which none can be left out, as far as the trials last."""
        groups = 2
        while len(items) > least:
            size = -(-len(items) // groups)
            chunks = [items[start : start + size] for start in range(0, len(items), size)]
            for left_out in chunks:
                kept = [item for item in items if not any(item is one for one in left_out)]
                if len(kept) >= least and self._still_fails(build(kept)):
                    items, groups = kept, max(groups - 1, 2)
                    break
            else:
                if size == 1:
                    break
                groups = min(2 * groups, len(items))
        return items

    def _shorten(self, script: FaultScript) -> FaultScript:
        """Halve the durations of the faults, one by one."""
        for number in range(len(script.faults)):
            while True:
                fault = script.faults[number]
                if fault.until_s is None or fault.until_s - fault.at_s < 2.0 * SHORTEST_S:
                    break
                until_s = round(fault.at_s + 0.5 * (fault.until_s - fault.at_s), 1)
                shorter = msgspec.structs.replace(fault, until_s=until_s)
                faults = (*script.faults[:number], shorter, *script.faults[number + 1 :])
                candidate = msgspec.structs.replace(script, faults=faults)
                if not self._still_fails(candidate):
                    break
                script = candidate
        return script

    def _still_fails(self, script: FaultScript | None) -> bool:
        if script is None or self.trials >= self._trials_max:
            return False
        self.trials += 1
        return self._fails(script)


def _parts(script: FaultScript) -> list[Part]:
    return [*script.faults, *script.halts, *script.cancels, *script.tasks]


def with_parts(script: FaultScript, parts: Sequence[Part]) -> FaultScript:
    """A script with these parts alone; a task does not wait for a missing one."""
    tasks = tuple(part for part in parts if isinstance(part, TaskInput))
    ids = {order.task.id for order in tasks}
    return msgspec.structs.replace(
        script,
        faults=tuple(part for part in parts if isinstance(part, FaultSpec)),
        halts=tuple(part for part in parts if isinstance(part, HaltOrder)),
        cancels=tuple(part for part in parts if isinstance(part, CancelOrder) and part.task in ids),
        tasks=tuple(_without_absent(order, ids) for order in tasks),
    )


def _without_absent(order: TaskInput, ids: set[str]) -> TaskInput:
    after = tuple(name for name in order.task.after if name in ids)
    return msgspec.structs.replace(order, task=msgspec.structs.replace(order.task, after=after))


def with_sides_of(script: FaultScript, names: Collection[str]) -> tuple[FaultSpec, ...]:
    """The faults of a script, their sides without the robots that are not among these."""
    return tuple(
        msgspec.structs.replace(fault, side=tuple(name for name in fault.side if name in names))
        for fault in script.faults
    )


def _with_robots(script: FaultScript, robots: Sequence[object]) -> FaultScript | None:
    """A script with these robots; None if a fault is of one that is left out, or if none of them stays alive."""
    kept = tuple(robot for robot in script.robots if any(robot is one for one in robots))
    dead = {fault.robot for fault in script.faults if fault.kind is FaultKind.KILL and fault.until_s is None}
    if all(robot.name in dead for robot in kept):
        return None  # tasks stay undone then, even with correct code
    try:
        return msgspec.structs.replace(script, robots=kept, faults=with_sides_of(script, {one.name for one in kept}))
    except ValueError:
        return None
