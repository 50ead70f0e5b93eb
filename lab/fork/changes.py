"""Changes of a fork with respect to its parent, from a moment on."""

from collections.abc import Sequence
from typing import Any

import msgspec

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.errors import UsageError
from robrain.sim.faults.fault_spec import FaultSpec
from robrain.sim.scenarios.scenario import Scenario

CHANGES_MAX = 1000
"""Changes of one fork, its parents' included."""


class Without(msgspec.Struct, frozen=True, kw_only=True, tag="without", forbid_unknown_fields=True):
    """A robot's computer is switched off. Its body stays on the floor."""

    at_s: float
    robot: str


class AddTask(msgspec.Struct, frozen=True, kw_only=True, tag="task", forbid_unknown_fields=True):
    """A task is submitted."""

    at_s: float
    kind: str
    fields: dict[str, Any] = {}
    """Fields and parameters, named as in the messages."""


class SetPolicy(msgspec.Struct, frozen=True, kw_only=True, tag="policy", forbid_unknown_fields=True):
    """The coordinator plans with other parameters."""

    at_s: float
    planning: PlanningPolicy


class AddFault(msgspec.Struct, frozen=True, kw_only=True, tag="fault", forbid_unknown_fields=True):
    """A robot's hardware fails; the fault has its own time."""

    fault: FaultSpec

    @property
    def at_s(self) -> float:
        """Time of its beginning."""
        return self.fault.at_s


Change = Without | AddTask | SetPolicy | AddFault


def change_text(change: Change) -> str:
    """A change in a few words.

    >>> change_text(Without(at_s=12.0, robot="r2"))
    'without r2'
    """
    match change:
        case Without(robot=robot):
            return f"without {robot}"
        case AddTask(kind=kind, fields=fields):
            place = fields.get("place")
            return f"a task to {kind}" + (f" at {place[0]:g}, {place[1]:g}" if isinstance(place, list) else "")
        case SetPolicy():
            return "another planning policy"
        case AddFault(fault=fault):
            return f"{fault.robot}: {fault.kind.value.replace('_', ' ')}"


def check_changes(changes: Sequence[Change], scenario: Scenario) -> None:
    """Check that the robots of changes are there (UsageError if not; a fault is checked by its scenario)."""
    known = [f"r{number}" for number in range(1, scenario.robots + 1)]
    off: set[str] = set()
    if len(changes) > CHANGES_MAX:
        raise UsageError(f"expected at most {CHANGES_MAX} changes, got {len(changes)}")
    for change in changes:
        if not isinstance(change, Without):
            continue
        if change.robot not in known:
            there = f"r1 to r{scenario.robots}" if scenario.robots > 1 else "only r1"
            raise UsageError(f"--without {change.robot}: there is no such robot; there are {there}")
        if change.robot in off:
            raise UsageError(f"--without {change.robot}: it is switched off already")
        off.add(change.robot)


def with_faults(scenario: Scenario, changes: Sequence[Change]) -> Scenario:
    """The scenario with the faults among the changes, each of which has its own time."""
    return scenario.replace(
        faults=(*scenario.faults, *(change.fault for change in changes if isinstance(change, AddFault)))
    )
