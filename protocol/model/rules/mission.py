"""Missions: sets of tasks with an order, rules for failed ones, and one state.

As tables of a scenario file, or of a file with rules:

```toml
[[missions]]
name = "night-round"
parameters = { floor = 1 }

[[missions.steps]]
name = "gate"
task = { kind = "visit", place = "gate-{floor}" }
repeats = 2

[[missions.steps]]
name = "look"
task = { kind = "inspect", place = [4.0, 2.0], same_robot_as = "{gate}" }
on_failure = "skip"
```

A step's task has the fields of a file of tasks; they are templates (`template.py`). Their names are the mission's
parameters, `mission` for its id, and the names of steps before, which stand for the ids of their tasks.
"""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.checked import Checked, check_names
from robrain.protocol.model.ranges import Name
from robrain.protocol.model.rules.template import check_templates
from robrain.protocol.model.tasks.task import Parameters

MISSIONS_MAX = 256
STEPS_MAX = 64
MISSION = "mission"
"""Name of a mission's id among the values of its templates."""
OWN_FIELDS = ("id", "after")
"""Fields of tasks that the mission sets."""


PlainName = Annotated[str, Meta(max_length=63, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]*$(?!\n)")]
"""Letters, digits, `_` and `-`."""


class FailurePolicy(StrEnum):
    """Effect of a failed step on its mission."""

    STOP = "stop"
    """The mission has failed; its other tasks are cancelled."""
    SKIP = "skip"
    """The mission continues."""


class MissionOrder(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A mission to start."""

    name: Name
    """Of the mission among `[[missions]]`."""
    parameters: Parameters = msgspec.field(default_factory=dict)
    """Values of its parameters; the mission's defaults for those that are not given."""


class MissionStep(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[missions.steps]]`: one task of a mission."""

    name: PlainName
    """The task is called by it."""
    task: Parameters
    """Kind and fields of the task, as in a file of tasks, without `id` and `after`."""
    after: Annotated[tuple[Name, ...], Meta(max_length=STEPS_MAX)] | None = None
    """Steps above that must have ended before. Default: the step before it."""
    repeats: Annotated[int, Meta(ge=0, le=100)] = 0
    """How often the task is made again if it fails."""
    on_failure: FailurePolicy | MissionOrder = FailurePolicy.STOP
    """Effect of its failure: `stop`, `skip`, or a mission that is run; this one continues once that is done."""


class Mission(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[missions]]`: a mission that can be started by its name."""

    name: PlainName
    """Started missions are named after it."""
    parameters: Parameters = msgspec.field(default_factory=dict)
    """Its parameters, with their default values."""
    steps: Annotated[tuple[MissionStep, ...], Meta(min_length=1, max_length=STEPS_MAX)]

    def __post_init__(self) -> None:
        super().__post_init__()
        above: list[str] = []
        for step in self.steps:
            try:
                self._check_step(step, above)
            except ValueError as error:
                raise ValueError(f"mission {self.name}, step {step.name}: {error}") from error
            above.append(step.name)

    def _check_step(self, step: MissionStep, above: Sequence[str]) -> None:
        if step.name in (MISSION, *self.parameters, *above):
            raise ValueError("expected a name that no parameter and no other step has")
        if unknown := [name for name in step.after or () if name not in above]:
            raise ValueError(f"after: expected steps above ({', '.join(above) or 'there is none'}), got {unknown[0]}")
        if set_here := [name for name in OWN_FIELDS if name in step.task]:
            raise ValueError(f"task: expected no {set_here[0]}, which the mission sets")
        if not isinstance(step.task.get("kind"), str):
            raise ValueError("task: expected kind, such as visit")  # noqa: TRY004 - of a file
        check_templates("task", step.task, {MISSION: "", **self.parameters, **dict.fromkeys(self.before(step), "")})
        if isinstance(step.on_failure, MissionOrder):
            check_templates("on_failure.parameters", step.on_failure.parameters, self.parameters)

    def after(self, step: MissionStep) -> tuple[str, ...]:
        """The steps that must have ended before a step begins."""
        if step.after is not None:
            return step.after
        index = self.steps.index(step)
        return (self.steps[index - 1].name,) if index else ()

    def before(self, step: MissionStep) -> set[str]:
        """Those steps, and all that must have ended before them."""
        found = {*self.after(step)}
        for above in reversed(self.steps):
            found.update(self.after(above) if above.name in found else ())
        return found


def check_order(where: str, order: MissionOrder, missions: Mapping[str, Mission]) -> None:
    """Check that a mission is known and has the given parameters (ValueError, which begins with `where`)."""
    mission = missions.get(order.name)
    if mission is None:
        raise ValueError(f"{where}: there is no mission {order.name}; known are {', '.join(missions) or 'none'}")
    if unknown := [name for name in order.parameters if name not in mission.parameters]:
        known = ", ".join(mission.parameters) or "none"
        raise ValueError(f"{where}: mission {order.name} has no parameter {unknown[0]}; it has {known}")


def check_missions(missions: Sequence[Mission]) -> None:
    """Check missions that are to hold together (ValueError)."""
    check_names("mission", MISSIONS_MAX, missions)
    known = {mission.name: mission for mission in missions}
    runs: dict[str, set[str]] = {}
    for mission in missions:
        orders = {step.name: step.on_failure for step in mission.steps if isinstance(step.on_failure, MissionOrder)}
        for step, order in orders.items():
            check_order(f"mission {mission.name}, step {step}: on_failure", order, known)
        runs[mission.name] = {order.name for order in orders.values()}
    while ended := [name for name, others in runs.items() if not others & runs.keys()]:
        for name in ended:
            del runs[name]
    if runs:
        raise ValueError(f"on_failure: the missions {', '.join(runs)} run each other without end")
