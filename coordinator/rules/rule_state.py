"""State of a rule: whether it may make a task now, and which of its motes are in alarm."""

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Container, Iterable
from enum import IntEnum

import msgspec

from robrain.protocol.clock import NS_PER_S, to_ns, to_seconds
from robrain.protocol.messages.tasks.rule_messages import RuleStatus
from robrain.protocol.messages.team.standing_messages import JournalAlarm
from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.model.rules.rule import EventCondition, Per, ReadingCondition, Rule, ScheduleCondition

RUNS_MAX = 16
"""Older runs are forgotten."""
RATE_READINGS_MAX = 64
"""A rate is measured by about this number of readings: of those nearer to each other one is skipped."""
RATE_READINGS_MIN = 3
RATE_SPAN_MIN = 0.5
"""A rate needs readings from at least this share of the time over which it is measured."""
NS_PER_MIN = 60 * NS_PER_S


class Class(IntEnum):
    """How one reading stands to a condition."""

    CLEAR = -1
    """At or beyond the level at which the rule is armed again."""
    BETWEEN = 0
    HOLDS = 1


class ReadingSpan(msgspec.Struct):
    """An uninterrupted time in which all known readings were of one class."""

    first_ns: int
    """When the first of them was measured."""
    last_ns: int
    of: Class


class LevelTrack:
    """State of one mote for one rule, in bounded memory.

    Args:
        condition: the rule's.

    """

    def __init__(self, condition: ReadingCondition) -> None:
        self._condition = condition
        self._runs: list[ReadingSpan] = []
        self._rates: list[tuple[int, float]] = []
        self.newest_ns = -1
        """When the latest reading was taken."""
        self.value = 0.0
        """Its value."""
        self.rate_per_min = 0.0
        """Rate of the value up to then; 0 if it is not measured."""

    @property
    def newest(self) -> Class:
        """How the mote stands now, by its latest reading."""
        return self._runs[-1].of if self._runs else Class.BETWEEN

    @property
    def held_s(self) -> float | None:
        """For how long the condition has held, up to the latest reading; None if it does not hold."""
        run = self._runs[-1] if self._runs else None
        return None if run is None or run.of is not Class.HOLDS else to_seconds(run.last_ns - run.first_ns)

    def record(self, measured_ns: int, value: float, gap_ns: int) -> None:
        """A reading has come.

        Args:
            measured_ns: when it was taken.
            value: its value.
            gap_ns: readings farther apart than this give no state for the time between them.

        """
        is_newest = measured_ns >= self.newest_ns
        if is_newest:
            self.newest_ns, self.value = measured_ns, value
        if not self._condition.is_rate:
            self._add(measured_ns, self._class_of(value), gap_ns)
            return
        rate_per_min = self._rate_with(measured_ns, value)
        if rate_per_min is not None:
            self.rate_per_min = rate_per_min
            self._add(self.newest_ns, self._class_of(rate_per_min), gap_ns)

    def _class_of(self, value: float) -> Class:
        level = self._condition.sign * value
        if level > self._condition.level_min:
            return Class.HOLDS
        return Class.CLEAR if level <= self._condition.clear_level else Class.BETWEEN

    def _add(self, at_ns: int, of: Class, gap_ns: int) -> None:
        runs = self._runs
        index = bisect_right(runs, at_ns, key=lambda run: run.first_ns)
        before = runs[index - 1] if index else None
        if before is not None and at_ns <= before.last_ns:
            if before.of is of:
                return
            # Where the readings within the run were is not known any more: only its ends are certain.
            parts = [ReadingSpan(at_ns, at_ns, of)]
            if before.first_ns < at_ns:
                parts.insert(0, ReadingSpan(before.first_ns, before.first_ns, before.of))
            if before.last_ns > at_ns:
                parts.append(ReadingSpan(before.last_ns, before.last_ns, before.of))
            runs[index - 1 : index] = parts
        else:
            after = runs[index] if index < len(runs) else None
            joins_before = before is not None and before.of is of and at_ns - before.last_ns <= gap_ns
            joins_after = after is not None and after.of is of and after.first_ns - at_ns <= gap_ns
            if before is not None and joins_before:
                before.last_ns = at_ns
                if after is not None and joins_after:
                    before.last_ns = after.last_ns
                    del runs[index]
            elif after is not None and joins_after:
                after.first_ns = at_ns
            else:
                runs.insert(index, ReadingSpan(at_ns, at_ns, of))
        del runs[:-RUNS_MAX]

    def _rate_with(self, measured_ns: int, value: float) -> float | None:
        """Slope of the least-squares line through the readings of `over_s`, with this one, per minute."""
        rates, over_ns = self._rates, to_ns(self._condition.over_s)
        index = bisect_right(rates, measured_ns, key=lambda one: one[0])
        apart_ns = over_ns // RATE_READINGS_MAX
        near = [each for each in rates[max(0, index - 1) : index + 1] if abs(each[0] - measured_ns) < apart_ns]
        if not near:
            rates.insert(index, (measured_ns, value))
        stale = bisect_right(rates, self.newest_ns - over_ns - 1, key=lambda one: one[0])
        del rates[:stale]
        if len(rates) < RATE_READINGS_MIN or rates[-1][0] - rates[0][0] < RATE_SPAN_MIN * over_ns:
            return None
        count, base_ns = len(rates), rates[0][0]
        mean_min = sum((at_ns - base_ns) / NS_PER_MIN for at_ns, _ in rates) / count
        mean = sum(value for _, value in rates) / count
        spread = across = 0.0
        for at_ns, each in rates:
            off_min = (at_ns - base_ns) / NS_PER_MIN - mean_min
            spread += off_min * off_min
            across += off_min * (each - mean)
        return across / spread


NAMED = 3
"""Most motes or robots listed by name; longer lists end with the number of the rest."""


def waits_for(rule: Rule) -> str:
    """The condition of a rule and the kind of its task, or its mission, as a phrase.

    >>> from robrain.protocol.model.rules.rule import TaskOrder
    >>> heat = ReadingCondition(quantity="temperature_c", above=26.0, for_s=10.0, clear_at=24.0)
    >>> waits_for(Rule(name="heat", reading=heat, task=TaskOrder(kind="visit")))
    'temperature_c above 26 for 10 s; then visit'
    """
    condition = rule.trigger
    if isinstance(condition, ScheduleCondition):
        what = f"{condition.rrule} in {condition.time_zone}"
    else:
        what = _reading(condition) if isinstance(condition, ReadingCondition) else _event(condition)
    then = rule.task.kind if rule.task is not None else f"mission {rule.mission.name}" if rule.mission else ""
    return f"{what}; then {then}"


def _reading(condition: ReadingCondition) -> str:
    held = f" for {condition.for_s:g} s" if condition.for_s else ""
    if condition.is_rate:
        verb = "rising" if condition.comparison == "rising_per_min" else "falling"
        how = f"{verb} by more than {condition.threshold:g} per minute"
    else:
        how = f"{condition.comparison} {condition.threshold:g}"
    of_motes, by_robots = _of(condition.motes, "of", "motes"), _of(condition.robots, "heard by", "robots")
    area = condition.area
    where = (
        ""
        if area is None
        else f" within x {area.x_min_m:g} to {area.x_max_m:g} m, y {area.y_min_m:g} to {area.y_max_m:g} m"
    )
    return f"{condition.quantity}{of_motes} {how}{held}{by_robots}{where}"


def _event(condition: EventCondition) -> str:
    part = f" {condition.field}" if condition.field else ""
    sides = [
        f"{side} {value:g}"
        for side, value in (("above", condition.above), ("below", condition.below))
        if value is not None
    ]
    value = f" with{part or ' a value'} {' and '.join(sides)}" if sides else ""
    return f"{condition.event} of {condition.plugin}{_of(condition.robots, 'on', 'robots')}{value}"


def _of(names: tuple[str, ...], word: str, many: str) -> str:
    if not names:
        return ""
    return f" {word} {', '.join(names)}" if len(names) <= NAMED else f" {word} {len(names)} {many}"


RETRY_NS = to_ns(10.0)
"""After a task of it was refused, a rule waits for at least this time (chosen)."""
SILENT_NS = to_ns(60.0)
"""A mote that has been silent for this time, and for three of its periods, is not counted as in alarm (chosen)."""
TRACKS_MAX = 8192
"""Motes that are followed, of all rules together; each takes at most some kilobytes."""


class TrackTable:
    """The motes that rules follow. When it is full, one that has fallen silent makes room for a new one."""

    def __init__(self, capacity: int = TRACKS_MAX) -> None:
        self._capacity = capacity
        self._tracks: OrderedDict[tuple[str, str], tuple[LevelTrack, int]] = OrderedDict()
        """By rule and mote, with the time of the last reading; the oldest first."""

    def __len__(self) -> int:
        return len(self._tracks)

    def of(self, rule: str, mote: str, condition: ReadingCondition, now_ns: int) -> LevelTrack | None:
        """A rule's state of a mote whose reading has arrived; None if there is no room for it."""
        key = (rule, mote)
        found = self._tracks.get(key)
        if found is None and len(self._tracks) >= self._capacity:
            oldest, (_, received_ns) = next(iter(self._tracks.items()))
            if now_ns - received_ns < SILENT_NS:
                return None
            del self._tracks[oldest]
        track = LevelTrack(condition) if found is None else found[0]
        self._tracks[key] = (track, now_ns)
        self._tracks.move_to_end(key)
        return track

    def keep(self, rules: Container[str]) -> None:
        """Forget the motes of all other rules."""
        for key in [key for key in self._tracks if key[0] not in rules]:
            del self._tracks[key]


class RuleState:
    """One rule, and its actions up to now.

    Args:
        rule: the rule.
        alarms: the journal's entries for it.
        open_tasks: its tasks that are open.
        now_ns: the time.

    """

    def __init__(self, rule: Rule, alarms: Iterable[JournalAlarm], open_tasks: Iterable[str], now_ns: int) -> None:
        self.rule = rule
        self.alarms = {alarm.source: alarm for alarm in alarms}
        self._open = set(open_tasks)
        self._last_ns = max((alarm.fired_ns for alarm in self.alarms.values()), default=0)
        self._not_before_ns = self._last_ns + to_ns(rule.cooldown_s) if self.alarms else 0
        self._waits = cut(waits_for(rule), TEXT_MAX)
        self._made = 0
        self._refused = 0
        self._refusal = ""
        self._alight: OrderedDict[str, int] = OrderedDict()
        """Motes that have met the condition and were not clear since, with the time until which that counts."""
        is_in_alarm = any(not alarm.is_armed for alarm in self.alarms.values())
        self._trusted_ns = now_ns + SILENT_NS if is_in_alarm else now_ns
        """From then on all motes have had time to report: those in alarm are known again."""

    def source_of(self, name: str) -> str:
        """Under which name a mote, or a robot, is in alarm."""
        return "" if self.rule.per is Per.TEAM else name

    def in_alarm(self, source: str) -> JournalAlarm | None:
        """The alarm for which a source has made a task, if it was not armed again since."""
        alarm = self.alarms.get(source)
        return None if alarm is None or alarm.is_armed else alarm

    def record_level(self, mote: str, track: LevelTrack, gap_ns: int, now_ns: int) -> None:
        """A reading of a mote has come; for what is in alarm as a whole."""
        if self.rule.per is not Per.TEAM:
            return
        if track.newest is Class.HOLDS or mote in self._alight:
            self._alight[mote] = now_ns + max(SILENT_NS, gap_ns)
            self._alight.move_to_end(mote)
        if track.newest is Class.CLEAR:
            self._alight.pop(mote, None)
        while self._alight and next(iter(self._alight.values())) < now_ns:
            self._alight.popitem(last=False)

    def is_clear(self, alarm: JournalAlarm, track: LevelTrack, now_ns: int) -> bool:
        """Whether a source that is in alarm is to be armed again, after a reading of a mote of it."""
        if track.newest_ns <= alarm.measured_ns:
            return False
        if self.rule.per is Per.TEAM:
            return not self._alight and now_ns >= self._trusted_ns
        return track.newest is Class.CLEAR

    def may_make(self, now_ns: int, is_open: Callable[[str], bool]) -> bool:
        """Whether a task may be made now, by cool-down and the number of open ones."""
        if now_ns < self._not_before_ns:
            return False
        self._open = {task for task in self._open if is_open(task)}
        return len(self._open) < self.rule.max_open

    def made(self, task: str, alarm: JournalAlarm) -> None:
        """A task was made."""
        self.alarms[alarm.source] = alarm
        self._open.add(task)
        self._made += 1
        self._last_ns = alarm.fired_ns
        self._not_before_ns = alarm.fired_ns + to_ns(self.rule.cooldown_s)

    def refused(self, refusal: str, now_ns: int) -> None:
        """A task was not made, because it is impossible now."""
        self._refused += 1
        self._refusal = refusal
        self._not_before_ns = now_ns + max(RETRY_NS, to_ns(self.rule.cooldown_s))

    def skipped(self, why: str) -> None:
        """A task was not made at its time, and will not be."""
        self._refused += 1
        self._refusal = why

    def status(self, is_open: Callable[[str], bool], next_ns: int = 0) -> RuleStatus:
        """As it is published."""
        self._open = {task for task in self._open if is_open(task)}
        return RuleStatus(
            name=self.rule.name,
            waits=self._waits,
            made=self._made,
            open=len(self._open),
            alarms=sum(not alarm.is_armed for alarm in self.alarms.values()),
            refused=self._refused,
            why=self._refusal,
            last_ns=self._last_ns,
            next_ns=next_ns,
        )
