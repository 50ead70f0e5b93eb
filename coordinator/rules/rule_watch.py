"""Rule watches: whether a rule may make a task now, and what of it is in alarm."""

from collections import OrderedDict
from collections.abc import Callable, Iterable

from robrain.coordinator.journal.alarm import Alarm
from robrain.coordinator.rules.level_track import Class, LevelTrack
from robrain.coordinator.rules.rule import Per, ReadingCondition, Rule
from robrain.coordinator.rules.rule_words import waits_for
from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.messages.tasks.rule_messages import RuleStatus

RETRY_NS = to_ns(10.0)
"""After a task of it was refused, a rule waits for at least so long (chosen)."""
SILENT_NS = to_ns(60.0)
"""A mote that has been silent for so long, and for three of its periods, is not counted as in alarm (chosen)."""
TRACKS_MAX = 8192
"""Motes that are followed, of all rules together; each takes at most some kilobytes."""


class TrackTable:
    """The motes that rules follow. When it is full, one that has fallen silent makes room for a new one."""

    def __init__(self, capacity: int = TRACKS_MAX) -> None:
        self.turned_away = 0
        """Readings of motes for which there was no room."""
        self._capacity = capacity
        self._tracks: OrderedDict[tuple[str, str], tuple[LevelTrack, int]] = OrderedDict()
        """By rule and mote, with the time when last heard; the one heard longest ago first."""

    def __len__(self) -> int:
        return len(self._tracks)

    def of(self, rule: str, mote: str, condition: ReadingCondition, now_ns: int) -> LevelTrack | None:
        """What a rule knows of a mote that is just heard; None if there is no room for it."""
        key = (rule, mote)
        found = self._tracks.get(key)
        if found is None and len(self._tracks) >= self._capacity:
            oldest, (_, heard_ns) = next(iter(self._tracks.items()))
            if now_ns - heard_ns < SILENT_NS:
                self.turned_away += 1
                return None
            del self._tracks[oldest]
        track = LevelTrack(condition) if found is None else found[0]
        self._tracks[key] = (track, now_ns)
        self._tracks.move_to_end(key)
        return track


class RuleWatch:
    """One rule, and what it has done.

    Args:
        rule: the rule.
        alarms: what the journal has of it.
        open_tasks: its tasks that are open.
        now_ns: the time.

    """

    def __init__(self, rule: Rule, alarms: Iterable[Alarm], open_tasks: Iterable[str], now_ns: int) -> None:
        self.rule = rule
        self.alarms = {alarm.source: alarm for alarm in alarms}
        self._open = set(open_tasks)
        self._last_ns = max((alarm.fired_ns for alarm in self.alarms.values()), default=0)
        self._not_before_ns = self._last_ns + to_ns(rule.cooldown_s) if self.alarms else 0
        self._waits = cut(waits_for(rule), TEXT_MAX)
        self._made = 0
        self._refused = 0
        self._why = ""
        self._alight: OrderedDict[str, int] = OrderedDict()
        """Motes that have met the condition and were not clear since, with the time until which that counts."""
        is_in_alarm = any(not alarm.is_armed for alarm in self.alarms.values())
        self._trusted_ns = now_ns + SILENT_NS if is_in_alarm else now_ns
        """From then on all motes have had time to be heard: those in alarm are known again."""

    def source_of(self, name: str) -> str:
        """Under which name a mote, or a robot, is in alarm."""
        return "" if self.rule.per is Per.TEAM else name

    def in_alarm(self, source: str) -> Alarm | None:
        """The alarm for which a source has made a task, if it was not armed again since."""
        alarm = self.alarms.get(source)
        return None if alarm is None or alarm.is_armed else alarm

    def note_level(self, mote: str, track: LevelTrack, gap_ns: int, now_ns: int) -> None:
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

    def is_clear(self, alarm: Alarm, track: LevelTrack, now_ns: int) -> bool:
        """Whether a source that is in alarm is to be armed again, after a reading of a mote of it."""
        if track.newest_ns <= alarm.taken_ns:
            return False
        if self.rule.per is Per.TEAM:
            return not self._alight and now_ns >= self._trusted_ns
        return track.newest is Class.CLEAR

    def may_make(self, now_ns: int, is_open: Callable[[str], bool]) -> bool:
        """Whether a task may be made now, as far as cool-down and the number of open ones go."""
        if now_ns < self._not_before_ns:
            return False
        self._open = {task for task in self._open if is_open(task)}
        return len(self._open) < self.rule.max_open

    def made(self, task: str, alarm: Alarm) -> None:
        """A task was made."""
        self.alarms[alarm.source] = alarm
        self._open.add(task)
        self._made += 1
        self._last_ns = alarm.fired_ns
        self._not_before_ns = alarm.fired_ns + to_ns(self.rule.cooldown_s)

    def refused(self, why: str, now_ns: int) -> None:
        """A task was not made, because it is impossible now."""
        self._refused += 1
        self._why = why
        self._not_before_ns = now_ns + max(RETRY_NS, to_ns(self.rule.cooldown_s))

    def status(self, is_open: Callable[[str], bool]) -> RuleStatus:
        """As it is published."""
        self._open = {task for task in self._open if is_open(task)}
        return RuleStatus(
            name=self.rule.name,
            waits=self._waits,
            made=self._made,
            open=len(self._open),
            alarms=sum(not alarm.is_armed for alarm in self.alarms.values()),
            refused=self._refused,
            why=self._why,
            last_ns=self._last_ns,
        )
