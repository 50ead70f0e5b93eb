"""A team with rules, and motes that say what a test has them say."""

from collections.abc import Sequence

import msgspec

from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.planning.policy import NEAREST, PlanningPolicy
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, PluginEvent
from robrain.protocol.messages.tasks.rule_messages import (
    COORDINATOR_RULES_CHANGE,
    COORDINATOR_RULES_NOW,
    RuleChange,
    RuleTable,
)
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.rules.rule import Rule

NO_PLANS = PlanningPolicy(method=NEAREST)
"""What a rule makes does not depend on how it is planned."""
PLACE = Point2D(6.5, 4.0)


def rule(name="heat", *, reading=None, event=None, task=None, **fields) -> Rule:
    """A rule as a file has it; a threshold of 26 °C unless something else is given."""
    if reading is None and event is None and "schedule" not in fields:
        reading = {"above": 26.0}
    if reading is not None:
        fields["reading"] = {"quantity": "temperature_c", **reading}
    if event is not None:
        fields["event"] = event
    if "mission" not in fields:
        fields["task"] = {"kind": "visit", **(task or {})}
    return msgspec.convert({"name": name, **fields}, Rule)


class SensedTeam:
    """One robot in a closed room, and motes."""

    def __init__(self, team, *rules: Rule, missions: Sequence[Mission] = (), journal: Journal | None = None) -> None:
        self.team, self.missions = team, missions
        self.journal = Journal() if journal is None else journal
        self._wire = team.endpoint()
        self._readings = {}
        self._events = {}
        self._sequences = {}
        self.restart(*rules)
        self.robot = team.robot("r1", 4.5, 3.0)
        team.closed_room()
        team.run(1.0)

    def restart(self, *rules: Rule) -> None:
        self.team.begin(self.journal, NO_PLANS, rules, self.missions)

    @property
    def now_s(self) -> float:
        return self.team.clock.now_ns() / 1e9

    def sense(self, value, mote="m1", *, age_s=0.0, sequence=-1, place=PLACE, **fields) -> MoteReading:
        """A mote's reading is brought in, with the next number unless one is given."""
        if sequence == -1:
            sequence = self._sequences[mote] = self._sequences.get(mote, 0) + 1
        if mote not in self._readings:
            self._readings[mote] = self._wire.publisher(MOTE_READING, mote=mote)
        fields = {"quantity": "temperature_c", "via": "r1", "period_s": 2.0} | fields
        reading = MoteReading(mote=mote, place=place, value=value, voltage_v=3.0, rssi_dbm=-60.0, sequence=sequence,
                              measured_ns=self.team.clock.now_ns() - to_ns(age_s), **fields)  # fmt: skip
        self._readings[mote].put(reading)
        return reading

    def again(self, reading: MoteReading, **fields) -> None:
        """The same reading once more, heard by somebody else maybe."""
        self._readings[reading.mote].put(msgspec.structs.replace(reading, **fields))

    def senses(self, *values, mote="m1", every_s=2.0, **fields) -> None:
        """Readings one after the other, with the mote's period between them."""
        for value in values:
            self.sense(value, mote, **fields)
            self.team.run(every_s)

    def notify(self, value, robot="r1", plugin="monitor", event="changed", stamp_ns=None, run_s=0.0) -> None:
        key = (robot, plugin, event)
        if key not in self._events:
            self._events[key] = self._wire.publisher(ROBOT_EVENT, robot=robot, plugin=plugin, event=event)
        self._events[key].put(PluginEvent(robot=robot, plugin=plugin, event=event, value=value), stamp_ns)
        self.team.run(run_s)

    def change(self, *put: Rule, remove=()) -> list[str]:
        """Change the rules; returns the names of all."""
        table = self.team.ask(COORDINATOR_RULES_CHANGE, RuleChange(put=[*put], remove=[*remove]), RuleTable)
        assert [state.name for state in table.states] == [each.name for each in table.rules]
        assert table == self.team.ask(COORDINATOR_RULES_NOW, None, RuleTable)
        return [each.name for each in table.rules]

    def made(self, name="heat"):
        """The tasks of a rule, oldest first, as the journal has them."""
        return self.journal.select(TaskFilter(by=f"rule:{name}"))

    def status(self, name="heat"):
        return next(one for one in self.team.summary.rules if one.name == name)
