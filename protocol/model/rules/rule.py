"""Rules: the readings, events or times for which a task is made, and that task.

As tables of a scenario file, or of a separate file:

```toml
[[rules]]
name = "heat"
cooldown_s = 120.0

[rules.reading]
quantity = "temperature_c"
above = 26.0
for_s = 10.0
clear_at = 24.0

[rules.task]
kind = "seek"
parameters = { quantity = "{quantity}" }
```

Parameters of the task are templates (`template.py`), filled with values of the reading or event.
"""

from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.checked import Checked, check_names
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Duration, KeyName, Metres, Name, PositiveDuration, Priority, Quantity
from robrain.protocol.model.recurrence import Recurrence
from robrain.protocol.model.rules.mission import Mission, MissionOrder, check_order
from robrain.protocol.model.rules.template import Values, check_templates, fill, names_in
from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS, check_parameters
from robrain.protocol.model.tasks.task import BadParameters, Needs, Parameters, Task

RULES_MAX = 256
BY = "rule:"
"""The requester of a rule's task is this and the rule's name."""
_OF_PLACE: Values = {"x_m": 0.0, "y_m": 0.0, "place": {"x_m": 0.0, "y_m": 0.0}}
OF_READING: Values = {"quantity": "temperature_c", "value": 1.0, "mote": "m1", "robot": "r1", **_OF_PLACE}
"""Values of a reading that may fill parameters, with an example of each. `robot` is the one that received it."""
OF_EVENT: Values = {"robot": "r1", "plugin": "monitor", "event": "changed", "value": 1.0, **_OF_PLACE}
"""From an event. `value` is the event's, or the field of it that the rule names; the place is the robot's."""
OF_SCHEDULE: Values = {"due": "2026-12-01 08:00:00"}
"""From a schedule: the local time of the occurrence."""

Selected = Annotated[tuple[Name, ...], Meta(max_length=1000)]


class Area(Checked, frozen=True, forbid_unknown_fields=True):
    """A rectangle of the floor, arena frame."""

    x_min_m: Metres
    """Least x."""
    y_min_m: Metres
    """Least y."""
    x_max_m: Metres
    """Greatest x."""
    y_max_m: Metres
    """Greatest y."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.x_min_m < self.x_max_m and self.y_min_m < self.y_max_m):
            raise ValueError("expected x_min_m below x_max_m and y_min_m below y_max_m")

    def holds(self, place: Point2D | None) -> bool:
        """Whether a place is in the area; False for an unknown place."""
        return (
            place is not None
            and self.x_min_m <= place.x_m <= self.x_max_m
            and self.y_min_m <= place.y_m <= self.y_max_m
        )


class ReadingCondition(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[rules.reading]`: a condition on readings, with one of `above`, `below`, `rising_per_min` or `falling_per_min`.

    Readings may arrive in any order; the time of measurement counts.
    """

    quantity: Name
    """Measured quantity, as readings name it, such as `temperature_c`."""
    above: Quantity | None = None
    """The value is above this."""
    below: Quantity | None = None
    """The value is below this."""
    rising_per_min: Quantity | None = None
    """The value rises by more than this per minute, by a straight line through a mote's readings of `over_s`."""
    falling_per_min: Quantity | None = None
    """The value falls by more than this per minute."""
    for_s: Duration = 0.0
    """How long all readings of a mote must have met the condition; with 0 one reading is enough."""
    over_s: PositiveDuration = 60.0
    """Time over which a rate is measured: at least three readings, from at least half of that time."""
    clear_at: Quantity | None = None
    """The rule is armed again when the value, or the rate, is back at this. Default: the threshold."""
    max_age_s: PositiveDuration = 60.0
    """A mote whose latest reading is older on arrival makes no task; such readings still count as its past."""
    motes: Selected = ()
    """Only readings of these motes; all if empty."""
    robots: Selected = ()
    """Only readings that these robots or gateways have received; all if empty."""
    area: Area | None = None
    """Only readings that were taken in this rectangle."""

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [name for name in LEVELS if getattr(self, name) is not None]
        if len(given) != 1:
            got = " and ".join(given) if given else "none"
            raise ValueError(f"expected one of above, below, rising_per_min and falling_per_min, got {got}")
        if self.is_rate and not self.threshold > 0:
            raise ValueError(f"expected {given[0]} > 0, got {self.threshold}")
        if self.clear_level > self.level_min:
            side = "at least" if self.comparison == "below" else "at most"
            raise ValueError(f"expected clear_at to be {side} {given[0]} = {self.threshold:g}, got {self.clear_at:g}")

    @property
    def comparison(self) -> str:
        """The name of the threshold."""
        return next(name for name in LEVELS if getattr(self, name) is not None)

    @property
    def threshold(self) -> float:
        """As it was given."""
        value = getattr(self, self.comparison)
        assert value is not None
        return float(value)

    @property
    def is_rate(self) -> bool:
        """Whether the rate of the value is compared, not the value."""
        return self.comparison in ("rising_per_min", "falling_per_min")

    @property
    def sign(self) -> float:
        """A value or rate, times this, is the level, which is above `level_min` where the condition holds."""
        return -1.0 if self.comparison in ("below", "falling_per_min") else 1.0

    @property
    def level_min(self) -> float:
        """The condition holds above this level."""
        return -self.threshold if self.comparison == "below" else self.threshold

    @property
    def clear_level(self) -> float:
        """At or below this level the rule is armed again."""
        if self.clear_at is None:
            return self.level_min
        return -self.clear_at if self.comparison == "below" else self.clear_at


LEVELS = ("above", "below", "rising_per_min", "falling_per_min")


class EventCondition(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[rules.event]`: which notification of a plugin makes the task; each one counts by itself."""

    plugin: Name
    """The plugin that notifies."""
    event: Name
    """Name of its event, one that leaves the robot."""
    robots: Selected = ()
    """Only of these robots; of all if empty."""
    field: Name = ""
    """The part of the event's value that counts, with dots where it is nested; empty for the value itself."""
    above: Quantity | None = None
    """That part must be a number above this."""
    below: Quantity | None = None
    """That part must be a number below this."""
    max_age_s: PositiveDuration = 60.0
    """An event that is older on arrival makes no task."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.above is not None and self.below is not None and not self.above < self.below:
            raise ValueError(f"expected above less than below, got {self.above:g} and {self.below:g}")

    def holds(self, value: object) -> bool:
        """Whether the part of an event's value is as it has to be."""
        if self.above is None and self.below is None:
            return True
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        return (self.above is None or value > self.above) and (self.below is None or value < self.below)


class TaskOrder(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[rules.task]`: the task that is made."""

    kind: Name
    """Kind of task, such as `seek` or `inspect`."""
    place_m: tuple[Metres, Metres] | None = None
    """Where, arena frame. Default: where the reading was taken, or where the robot of the event is."""
    place: Name = ""
    """Name of a zone, in place of `place_m`; the task is done at its centre."""
    priority: Priority = 1.0
    """Reward for doing it."""
    deadline_s: PositiveDuration | None = None
    """Time from the making of the task by which it must be done."""
    service_s: Duration = 0.0
    """Expected time at its place."""
    needs: Needs = ()
    """Names of plugins that a robot must have for it, besides the behavior."""
    parameters: Parameters = msgspec.field(default_factory=dict)
    """Further parameters of its kind. `{value}`, `{mote}` and others in texts are replaced: see the how-to on rules."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.kind:
            raise ValueError("expected a kind of task, got an empty one")
        if self.place and self.place_m is not None:
            raise ValueError("expected either place or place_m, got both")
        if self.deadline_s is not None and self.service_s > self.deadline_s:
            raise ValueError(f"expected service_s of at most deadline_s = {self.deadline_s:g}, got {self.service_s:g}")

    def check(self, values: Values) -> None:
        """Check the parameters (ValueError), filled with these examples."""
        check_templates("task.parameters", self.parameters, values)
        if self.kind in STOCK_KINDS:
            parameters = fill(self.parameters, values)
            try:
                check_parameters(Task(id="t", kind=self.kind, place=Point2D(0.0, 0.0), parameters=parameters))
            except BadParameters as error:
                raise ValueError(f"task.parameters: {error}") from error

    @property
    def needs_place(self) -> bool:
        """Whether no task can be made unless it is known where the reading was taken."""
        is_given = self.place_m is not None or self.place
        return not is_given or not _OF_PLACE.keys().isdisjoint(names_in(self.parameters))


TRIGGERS: Mapping[str, Values] = {"reading": OF_READING, "event": OF_EVENT, "schedule": OF_SCHEDULE}
"""The triggers of rules, each with the values that may fill parameters of the task."""


class ScheduleCondition(Recurrence, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[rules.schedule]`: the times at which tasks are made."""

    max_age_s: PositiveDuration = 60.0
    """After an outage, the last missed occurrence makes a task if it is not older."""


class Per(StrEnum):
    """Subject of an alarm."""

    MOTE = "mote"
    """Each mote by itself; of events, each robot."""
    TEAM = "team"
    """All of them together: one task, until none of them is in alarm any more."""


class Rule(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[rules]]`: a task or a mission, and one of `[rules.reading]`, `[rules.event]` and `[rules.schedule]`."""

    name: KeyName
    """Letters, digits, `_`, `-` and `.`; its tasks are called by it."""
    task: TaskOrder | None = None
    mission: MissionOrder | None = None
    """The mission that is started in place of a task."""
    reading: ReadingCondition | None = None
    """Readings of motes that trigger it."""
    event: EventCondition | None = None
    """Events of plugins that trigger it."""
    schedule: ScheduleCondition | None = None
    """Times that trigger it."""
    per: Per = Per.MOTE
    """After a task the rule makes none until it is armed again: for each mote by itself, or for the whole team."""
    cooldown_s: Duration = 60.0
    """Least time between two tasks of the rule, for any trigger."""
    max_open: Annotated[int, Meta(ge=1, le=1000)] = 1
    """Most tasks of the rule that are open at the same time."""

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [name for name in TRIGGERS if getattr(self, name) is not None]
        if len(given) != 1:
            got = " and ".join(given) or "none"
            raise ValueError(f"rule {self.name}: expected one of reading, event and schedule, got {got}")
        if (self.task is None) == (self.mission is None):
            raise ValueError(f"rule {self.name}: expected either task or mission")
        if self.schedule is not None and self.task is not None and self.task.needs_place:
            raise ValueError(f"rule {self.name}: expected task.place or task.place_m for a schedule")
        try:
            if self.task is not None:
                self.task.check(TRIGGERS[given[0]])
            if self.mission is not None:
                check_templates("mission.parameters", self.mission.parameters, TRIGGERS[given[0]])
        except ValueError as error:
            raise ValueError(f"rule {self.name}: {error}") from error

    @property
    def trigger(self) -> ReadingCondition | EventCondition | ScheduleCondition:
        """Its one condition."""
        found = self.reading or self.event or self.schedule
        assert found is not None
        return found

    @property
    def needs_place(self) -> bool:
        """Whether it does nothing unless it is known where the reading was taken, or where the robot is."""
        if self.task is not None:
            return self.task.needs_place
        return self.mission is not None and not _OF_PLACE.keys().isdisjoint(names_in(self.mission.parameters))

    @property
    def by(self) -> str:
        """Requester of its tasks."""
        return f"{BY}{self.name}"


def check_rules(rules: Sequence[Rule], missions: Iterable[Mission] = ()) -> None:
    """Check rules that are to hold together, with the missions that they may start (ValueError)."""
    check_names("rule", RULES_MAX, rules)
    known = {mission.name: mission for mission in missions}
    for rule in rules:
        if rule.mission is not None:
            check_order(f"rule {rule.name}: mission", rule.mission, known)
