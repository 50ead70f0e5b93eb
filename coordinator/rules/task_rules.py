"""Makes tasks by rules, from the readings and events that meet them, and at the times of schedules.

The tasks are ordinary ones: they pass the same admission as those that people submit, are journalled, planned, offered
and explained alike. The source of a rule's task is written in the transaction that accepts the task, so that after a
restart none is made twice. Work and memory are bounded, however much arrives.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
from msgspec.structs import replace

from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.parts.changed_table import ChangedTable
from robrain.coordinator.parts.missions import Missions
from robrain.coordinator.rules.rule_state import RuleState, TrackTable
from robrain.coordinator.team.roster import Robot
from robrain.protocol.border.border import Received
from robrain.protocol.border.reading_sieve import ReadingSieve, measured_at_ns
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.errors import CallError
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, PluginEvent
from robrain.protocol.messages.tasks.rule_messages import (
    COORDINATOR_RULES_CHANGE,
    COORDINATOR_RULES_NOW,
    RuleChange,
    RuleStatus,
    RuleTable,
)
from robrain.protocol.messages.tasks.task_messages import TaskSubmission
from robrain.protocol.messages.team.standing_messages import JournalAlarm
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.recurrence import Occurrences
from robrain.protocol.model.rules.rule import EventCondition, ReadingCondition, Rule, TaskOrder, check_rules
from robrain.protocol.model.rules.template import Values, fill
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import PlainReason, plain
from robrain.protocol.refusals import RefusalCode
from robrain.protocol.topic import Topic
from robrain.protocol.wire.endpoint import Request, Serve

INBOX_MAX = 2048
"""Readings and events in one step; of more the oldest are dropped."""
REMEMBERED = 1 << 14
"""Readings of which repetitions are recognised."""
GAP_PERIODS = 3.0
GAP_MIN_S = 5.0
USUAL_PERIOD_S = 4.0
"""While a mote sends no reading in three periods, its state is unknown. This is the period of a mote that does not
report how often it senses."""


class TaskCause(NamedTuple):
    """Trigger of a task."""

    source: str
    """Mote or robot."""
    stamp_ns: int
    """When the reading was taken, or the event happened."""
    place: Point2D | None
    values: Values
    """For the parameters of the task."""
    reason: PlainReason


class RuleChanges(msgspec.Struct, frozen=True):
    """Changes of rules while the team ran."""

    rules: dict[str, Rule | None] = {}
    """Rules that were added, replaced or removed (None), by name."""


class TaskRules(CoordinatorPart):
    """Keeps all rules of a team.

    Args:
        core: the team; its journal keeps the alarms.
        rules: the rules of a file, checked as they are built.

    """

    inbox_max = INBOX_MAX

    def __init__(self, core: Core, rules: Sequence[Rule] = ()) -> None:
        super().__init__(core)
        self._missions = core.parts.find(Missions)
        self._check(rules)
        self.tracks = TrackTable()
        self.sieve = ReadingSieve(REMEMBERED)
        self._wire, self._book, self._roster = core.wire, core.tasks, core.roster
        self._now_ns = core.wire.clock.now_ns()
        self._states: list[RuleState] = []
        self._of_quantity: dict[str, list[tuple[RuleState, ReadingCondition]]] = {}
        self._of_event: dict[tuple[str, str], list[tuple[RuleState, EventCondition]]] = {}
        self._schedules: dict[str, tuple[RuleState, Occurrences]] = {}
        self._subscribed: set[tuple[str, ...]] = set()
        changes = self.stored(RuleChanges).rules
        self._table = ChangedTable("rule", changes, self._check, lambda rules: self.store(RuleChanges(rules=rules)))
        self._table.load(rules)
        if self._table.rows:
            self._apply()
            core.tasks.journal.keep_alarms(alarm for one in self._states for alarm in one.alarms.values())
        core.wire.answer(COORDINATOR_RULES_NOW, lambda _: self._message(), serve=Serve.IN_STEP)
        core.wire.answer(COORDINATOR_RULES_CHANGE, self._change, serve=Serve.IN_STEP)

    @property
    def has_open(self) -> bool:
        """Whether a task of a rule is open."""
        return any(status.open for status in self.status())

    def summary(self, state: TeamState, now_ns: int) -> TeamState:
        """Add the actions of the rules."""
        return replace(state, rules=self.status()) if self._states else state

    def status(self) -> list[RuleStatus]:
        """Each rule and its actions, in the order of the file."""
        next_ns = {name: occurrences.next_ns or 0 for name, (_, occurrences) in self._schedules.items()}
        return [one.status(self._is_open, next_ns.get(one.rule.name, 0)) for one in self._states]

    def _is_open(self, made: str) -> bool:
        """Whether a task or mission of a rule is open."""
        return self._book.is_open(made) or self._missions.is_open(made)

    # -- changes ----------------------------------------------------------------------------------------------

    def _check(self, rules: Sequence[Rule]) -> None:
        check_rules(rules, self._missions.known.values())

    def _change(self, request: Request[RuleChange]) -> RuleTable:
        if self._table.change(request.asked.put, request.asked.remove):
            self._now_ns = self._wire.clock.now_ns()
            self._apply()
            self.core.report_soon()
        return self._message()

    def _message(self) -> RuleTable:
        return RuleTable(rules=[one.rule for one in self._states], states=self.status())

    def _apply(self) -> None:
        """Follow the rules of the table; the states of those that have not changed stay."""
        same = {one.rule.name: one for one in self._states if self._table.rows.get(one.rule.name) == one.rule}
        self.tracks.keep(same)
        self._states = [same.get(one.rule.name, one) for one in self._restored([*self._table.rows.values()])]
        self._of_quantity.clear()
        self._of_event.clear()
        schedules, self._schedules = self._schedules, {}
        for rule_state in self._states:
            name, reading, event = rule_state.rule.name, rule_state.rule.reading, rule_state.rule.event
            if reading is not None:
                self._of_quantity.setdefault(reading.quantity, []).append((rule_state, reading))
                self._subscribe_once(MOTE_READING)
            if event is not None:
                self._of_event.setdefault((event.plugin, event.event), []).append((rule_state, event))
                self._subscribe_once(ROBOT_EVENT, plugin=event.plugin, event=event.event)
            if rule_state.rule.schedule is not None:
                new = (rule_state, Occurrences(rule_state.rule.schedule, self._now_ns))
                self._schedules[name] = schedules[name] if name in same else new

    def _subscribe_once(self, topic: Topic[Any], **names: str) -> None:
        if (key := (topic.name, *names.values())) not in self._subscribed:
            self._subscribed.add(key)
            self.subscribe(topic, **names)

    def _restored(self, rules: Sequence[Rule]) -> list[RuleState]:
        """The rules in the state that the journal has."""
        alarms: dict[str, list[JournalAlarm]] = {rule.name: [] for rule in rules}
        needed_s = {rule.name: max(rule.cooldown_s, rule.trigger.max_age_s) for rule in rules}
        for alarm in self._book.journal.alarms():
            if alarm.rule not in alarms:
                continue
            if not alarm.is_armed or self._now_ns - alarm.fired_ns < to_ns(needed_s[alarm.rule]):
                alarms[alarm.rule].append(alarm)
        open_tasks: dict[str, list[str]] = {}
        for record in self._book.open:
            open_tasks.setdefault(record.by, []).append(record.task.id)
        return [
            RuleState(
                rule,
                alarms[rule.name],
                [*open_tasks.get(rule.by, ()), *self._missions.open_by(rule.by)],
                self._now_ns,
            )
            for rule in rules
        ]

    # -- receiving --------------------------------------------------------------------------------------------

    def handle(self, received: Received, now_ns: int) -> None:
        """Make the tasks that follow from a reading or an event."""
        self._now_ns = now_ns
        if received.topic is ROBOT_EVENT:
            self._handle_event(received.message)
        else:
            self._handle_reading(received.message)

    def _handle_reading(self, reading: MoteReading) -> None:
        states = self._of_quantity.get(reading.quantity)
        if states is None or not self.sieve.is_new(reading):
            return
        for rule_state, condition in states:
            if _covers(condition, reading):
                self._judge(rule_state, condition, reading)

    def _judge(self, rule_state: RuleState, condition: ReadingCondition, reading: MoteReading) -> None:
        track = self.tracks.of(rule_state.rule.name, reading.mote, condition, self._now_ns)
        if track is None:
            return
        gap_ns = to_ns(max(GAP_MIN_S, GAP_PERIODS * (reading.period_s or USUAL_PERIOD_S)))
        track.record(measured_at_ns(reading), reading.value, gap_ns)
        rule_state.record_level(reading.mote, track, gap_ns, self._now_ns)
        source = rule_state.source_of(reading.mote)
        alarm = rule_state.in_alarm(source)
        if alarm is not None:
            if rule_state.is_clear(alarm, track, self._now_ns):
                self._arm(rule_state, alarm)
            return
        known = rule_state.alarms.get(source)
        if known is not None and track.newest_ns <= known.measured_ns:
            return  # the reading for which there was a task, sent again to a coordinator that has started again
        held_s, age_ns = track.held_s, self._now_ns - track.newest_ns
        if held_s is None or held_s < condition.for_s or age_ns > to_ns(condition.max_age_s):
            return
        place = reading.place
        if condition.is_rate:
            verb = condition.comparison.removesuffix("_per_min")
            how = f"{verb} by {abs(track.rate_per_min):.4g} per minute, more than {condition.threshold:g}"
        else:
            how = f"{condition.comparison} {condition.threshold:g}"
        held = f" for {held_s:.0f} s" if held_s > 0 else ""
        age_s = to_seconds(max(age_ns, 0))
        reason = plain(
            "rule_reading",
            f"rule {rule_state.rule.name}: {reading.mote} sensed {reading.quantity} {track.value:g}, {how}{held}, "
            f"{age_s:.1f} s before",
            rule=rule_state.rule.name,
            mote=reading.mote,
            quantity=reading.quantity,
            value=track.value,
            measured_ns=track.newest_ns,
            via=reading.via,
            comparison=condition.comparison,
            threshold=condition.threshold,
            held_s=round(held_s, 3),
            age_s=round(age_s, 3),
            **({"rate_per_min": round(track.rate_per_min, 6)} if condition.is_rate else {}),
        )
        values = {
            "quantity": reading.quantity,
            "value": track.value,
            "mote": reading.mote,
            "robot": reading.via,
            **_place_values(place),
        }
        self._make(rule_state, TaskCause(source, track.newest_ns, place, values, reason))

    def _handle_event(self, event: PluginEvent) -> None:
        state = self._roster.robots.get(event.robot)
        pose = None if state is None or state.state is None or state.state.frame != ARENA else state.state.pose
        place = None if pose is None else Point2D(pose.x_m, pose.y_m)
        for rule_state, condition in self._of_event.get((event.plugin, event.event), ()):
            value = _part(event.value, condition.field)
            is_meant = not condition.robots or event.robot in condition.robots
            is_old = self._now_ns - event.stamp_ns > to_ns(condition.max_age_s)
            source = rule_state.source_of(event.robot)
            known = rule_state.alarms.get(source)
            # A coordinator that starts again receives the last events again.
            is_known = known is not None and event.stamp_ns <= known.measured_ns
            if not is_meant or is_old or is_known or not condition.holds(value):
                continue
            event_values = {"robot": event.robot, "plugin": event.plugin, "event": event.event, "value": value}
            values = event_values | _place_values(place)
            number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
            shown = "" if number is None else f" {number:g}"
            reason = plain(
                "rule_event",
                f"rule {rule_state.rule.name}: {event.plugin} of {event.robot} notified of {event.event}{shown}",
                rule=rule_state.rule.name,
                robot=event.robot,
                plugin=event.plugin,
                event=event.event,
                stamp_ns=event.stamp_ns,
                **({} if number is None else {"value": number}),
            )
            self._make(rule_state, TaskCause(source, event.stamp_ns, place, values, reason))

    def assign(self, robots: Sequence[Robot], now_ns: int) -> None:
        """Make the tasks whose times have come."""
        self._now_ns = now_ns
        for rule_state, occurrences in self._schedules.values():
            due_ns = occurrences.latest_ns(now_ns)
            known = rule_state.alarms.get("")
            if due_ns is None or (known is not None and due_ns <= known.measured_ns):
                continue
            name, due = rule_state.rule.name, occurrences.text_of(due_ns)
            if now_ns - due_ns > to_ns(rule_state.rule.trigger.max_age_s):
                if known is not None:
                    rule_state.skipped(f"the task of {due} is left out: no coordinator ran")
            elif not rule_state.may_make(now_ns, self._is_open):
                rule_state.skipped(f"the task of {due} is left out: an earlier one is open, or ended just before")
            else:
                reason = plain("rule_schedule", f"rule {name}: due at {due}", rule=name, due_ns=due_ns)
                self._make(rule_state, TaskCause("", due_ns, None, {"due": due}, reason))
                self.core.assign_soon()

    # -- making tasks ---------------------------------------------------------------------------------------

    def _arm(self, rule_state: RuleState, alarm: JournalAlarm) -> None:
        armed = replace(alarm, is_armed=True)
        try:
            self._book.journal.record_alarm(armed)
        except JournalUnwritable as error:  # it stays in alarm until that can be written down
            rule_state.refused(str(error), self._now_ns)
            return
        rule_state.alarms[alarm.source] = armed

    def _make(self, rule_state: RuleState, cause: TaskCause) -> None:
        if not rule_state.may_make(self._now_ns, self._is_open):
            return
        rule, now_ns = rule_state.rule, self._now_ns
        is_armed = rule.reading is None  # an event is over at once: the next one counts again
        alarm = JournalAlarm(
            rule=rule.name, source=cause.source, measured_ns=cause.stamp_ns, fired_ns=now_ns, is_armed=is_armed
        )
        try:
            if cause.place is None and rule.needs_place:
                what = "the robot" if rule.reading is None else "the mote"
                raise ValueError(f"no task is made by rule {rule.name}: {what} does not know where it is")
            if rule.mission is not None:
                made = self._missions.new_id(rule.name)
                order = replace(rule.mission, parameters=fill(rule.mission.parameters, cause.values))
                self._missions.start(made, order, rule.by, alarm=alarm)
            else:
                assert rule.task is not None
                task = self._task(rule, rule.task, cause)
                asked = TaskSubmission(task=task, deadline_in_s=rule.task.deadline_s)
                made = self.core.requests.admit(asked, rule.by, reason=cause.reason, alarm=alarm).task.id
        except (CallError, ValueError) as error:
            refusal = error.message if isinstance(error, CallError) else str(error)
            rule_state.refused(refusal, now_ns)
            self._wire.refusals.record("rule", rule.name, RefusalCode.FAILED, refusal)
            return
        rule_state.made(made, alarm)

    def _task(self, rule: Rule, order: TaskOrder, cause: TaskCause) -> Task:
        """The task that a rule makes; ValueError if its place is not known."""
        place = cause.place if order.place_m is None else Point2D(*order.place_m)
        if order.place:
            if (zone := self.core.team_map.zone(order.place)) is None:
                raise ValueError(f"no task is made by rule {rule.name}: there is no place or zone {order.place}")
            place = zone.centre
        assert place is not None
        return Task(
            id=self.core.new_id(rule.name),
            kind=order.kind,
            place=place,
            priority=order.priority,
            service_s=order.service_s,
            needs=order.needs,
            parameters=fill(order.parameters, cause.values),
        )


def _covers(condition: ReadingCondition, reading: MoteReading) -> bool:
    """Whether a reading of the quantity is one that a rule is about."""
    return (
        (not condition.motes or reading.mote in condition.motes)
        and (not condition.robots or reading.via in condition.robots)
        and (condition.area is None or condition.area.holds(reading.place))
    )


def _place_values(place: Point2D | None) -> dict[str, Any]:
    return {} if place is None else {"x_m": place.x_m, "y_m": place.y_m, "place": msgspec.to_builtins(place)}


def _part(value: Any, field: str) -> Any:
    """A field of an event's value, with dots where it is nested; None if there is no such field."""
    for name in field.split(".") if field else ():
        value = value.get(name) if isinstance(value, dict) else None
    return value
