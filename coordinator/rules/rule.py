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

A parameter of the task that is one name in braces becomes that value of the reading or event. Names in other texts are
replaced by words. Braces have no other meaning: no attributes, no formats, no code.
"""

import re
from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from robrain.protocol.errors import BadName
from robrain.protocol.keys import check_name
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import NAME_MAX, Duration, Metres, Name, PositiveDuration, Priority, cut
from robrain.protocol.model.recurrence import Recurrence
from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS, check_parameters
from robrain.protocol.model.tasks.task import BadParameters, Needs, Parameters, Task

Values = Mapping[str, Any]
"""Values of names: plain JSON."""
DEPTH_MAX = 8
_BRACES = re.compile(r"\{([^{}]*)\}")


def check_template(template: object, values: Values, depth: int = 0) -> None:
    """Check that a parameter can be filled (ValueError): plain JSON, in which braces have only known names."""
    if depth > DEPTH_MAX:
        raise ValueError(f"expected at most {DEPTH_MAX} levels of tables and lists")
    if isinstance(template, str):
        for name in _BRACES.findall(template):
            if name not in values:
                known = ", ".join(f"{{{each}}}" for each in values)
                raise ValueError(f"expected one of {known}, got {{{name}}}")
        rest = _BRACES.sub("", template)
        if "{" in rest or "}" in rest:
            raise ValueError(f"expected braces in pairs around a name, got {template!r}")
    elif isinstance(template, dict):
        for part in template.values():
            check_template(part, values, depth + 1)
    elif isinstance(template, list | tuple):
        for part in template:
            check_template(part, values, depth + 1)
    elif not isinstance(template, bool | int | float):
        got = type(template).__name__
        raise ValueError(f"expected a text, number, list or table, got a {got}")  # noqa: TRY004 - of a file


def fill(template: Any, values: Values) -> Any:
    """A parameter with the names in braces replaced.

    >>> fill({"mote": "{mote}", "note": "{value} at {mote}"}, {"mote": "m3", "value": 27.5})
    {'mote': 'm3', 'note': '27.5 at m3'}
    >>> fill("{value}", {"value": 27.5})
    27.5
    """
    if isinstance(template, str):
        alone = _BRACES.fullmatch(template)
        if alone is not None:
            return values[alone.group(1)]
        return _BRACES.sub(lambda found: _word(values[found.group(1)]), template)
    if isinstance(template, dict):
        return {name: fill(part, values) for name, part in template.items()}
    return [fill(part, values) for part in template] if isinstance(template, list | tuple) else template


def _word(value: Any) -> str:
    return cut(f"{value:g}" if isinstance(value, float) else str(value), NAME_MAX)


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
    y_min_m: Metres
    x_max_m: Metres
    y_max_m: Metres

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
    above: float | None = None
    """The value is above this."""
    below: float | None = None
    """The value is below this."""
    rising_per_min: float | None = None
    """The value rises by more than this per minute, by a straight line through a mote's readings of `over_s`."""
    falling_per_min: float | None = None
    """The value falls by more than this per minute."""
    for_s: Duration = 0.0
    """How long all readings of a mote must have met the condition; with 0 one reading is enough."""
    over_s: PositiveDuration = 60.0
    """Time over which a rate is measured: at least three readings, from at least half of that time."""
    clear_at: float | None = None
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

    def covers(self, reading: MoteReading) -> bool:
        """Whether a reading of the quantity is one that the rule is about."""
        return (
            (not self.motes or reading.mote in self.motes)
            and (not self.robots or reading.via in self.robots)
            and (self.area is None or self.area.holds(reading.place))
        )


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
    above: float | None = None
    """That part must be a number above this."""
    below: float | None = None
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
        for name, parameter in self.parameters.items():
            try:
                check_template(parameter, values)
            except ValueError as error:
                raise ValueError(f"task.parameters.{name}: {error}") from error
        if self.kind in STOCK_KINDS:
            parameters = {name: fill(parameter, values) for name, parameter in self.parameters.items()}
            try:
                check_parameters(Task(id="t", kind=self.kind, place=Point2D(0.0, 0.0), parameters=parameters))
            except BadParameters as error:
                raise ValueError(f"task.parameters: {error}") from error

    @property
    def needs_place(self) -> bool:
        """Whether no task can be made unless it is known where the reading was taken."""
        used = _BRACES.findall(msgspec.json.encode(self.parameters).decode())
        is_given = self.place_m is not None or self.place
        return not is_given or not {"x_m", "y_m", "place"}.isdisjoint(used)


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
    """`[[rules]]`: a task, and one of `[rules.reading]`, `[rules.event]` and `[rules.schedule]`, which triggers it."""

    name: Name
    """Letters, digits, `_`, `-` and `.`; its tasks are called by it."""
    task: TaskOrder
    reading: ReadingCondition | None = None
    event: EventCondition | None = None
    schedule: ScheduleCondition | None = None
    per: Per = Per.MOTE
    """After a task the rule makes none until it is armed again: for each mote by itself, or for the whole team."""
    cooldown_s: Duration = 60.0
    """Least time between two tasks of the rule, for any trigger."""
    max_open: Annotated[int, Meta(ge=1, le=1000)] = 1
    """Most tasks of the rule that are open at the same time."""

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            check_name("rule", self.name)
        except BadName as error:
            raise ValueError(str(error)) from error
        given = [name for name in TRIGGERS if getattr(self, name) is not None]
        if len(given) != 1:
            got = " and ".join(given) or "none"
            raise ValueError(f"rule {self.name}: expected one of reading, event and schedule, got {got}")
        if self.schedule is not None and self.task.needs_place:
            raise ValueError(f"rule {self.name}: expected task.place or task.place_m for a schedule")
        try:
            self.task.check(TRIGGERS[given[0]])
        except ValueError as error:
            raise ValueError(f"rule {self.name}: {error}") from error

    @property
    def trigger(self) -> ReadingCondition | EventCondition | ScheduleCondition:
        """Its one condition."""
        found = self.reading or self.event or self.schedule
        assert found is not None
        return found

    @property
    def by(self) -> str:
        """Requester of its tasks."""
        return f"{BY}{self.name}"


def check_rules(rules: Iterable[Rule]) -> None:
    """Check rules that are to hold together (ValueError)."""
    names = [rule.name for rule in rules]
    if len(names) > RULES_MAX:
        raise ValueError(f"expected at most {RULES_MAX} rules, got {len(names)}")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"expected each rule to have a name of its own, got {', '.join(twice)} twice")
