"""Level tracks: how long the readings of one mote have held a rule's condition, judged by when they were taken.

Readings may come late, twice and in any order. A track keeps *runs*: times without a break in which all readings known
were of one class. A reading that comes late extends a run, joins two, or breaks one.
"""

from bisect import bisect_right
from enum import IntEnum

from robrain.coordinator.rules.rule import ReadingCondition
from robrain.protocol.wire.clock import NS_PER_S, to_ns, to_seconds

RUNS_MAX = 16
"""Older runs are forgotten."""
RATE_READINGS_MAX = 64
"""A rate is measured by about so many readings: of those nearer to each other one is left out."""
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


class Run:
    """A time without a break in which all readings known were of one class.

    Args:
        first_ns: when the first of them was taken.
        last_ns: when the last was.
        of: their class.

    """

    __slots__ = ("first_ns", "last_ns", "of")

    def __init__(self, first_ns: int, last_ns: int, of: Class) -> None:
        self.first_ns = first_ns
        self.last_ns = last_ns
        self.of = of


class LevelTrack:
    """What is known of one mote for one rule, in bounded memory.

    Args:
        condition: the rule's.

    """

    __slots__ = ("_condition", "_rates", "_runs", "newest_ns", "rate_per_min", "value")

    def __init__(self, condition: ReadingCondition) -> None:
        self._condition = condition
        self._runs: list[Run] = []
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

    def note(self, taken_ns: int, value: float, gap_ns: int) -> None:
        """A reading has come.

        Args:
            taken_ns: when it was taken.
            value: its value.
            gap_ns: readings farther apart than this say nothing of the time between them.

        """
        is_newest = taken_ns >= self.newest_ns
        if is_newest:
            self.newest_ns, self.value = taken_ns, value
        if not self._condition.is_rate:
            self._add(taken_ns, self._class_of(value), gap_ns)
            return
        rate_per_min = self._rate_with(taken_ns, value)
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
            parts = [Run(at_ns, at_ns, of)]
            if before.first_ns < at_ns:
                parts.insert(0, Run(before.first_ns, before.first_ns, before.of))
            if before.last_ns > at_ns:
                parts.append(Run(before.last_ns, before.last_ns, before.of))
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
                runs.insert(index, Run(at_ns, at_ns, of))
        del runs[:-RUNS_MAX]

    def _rate_with(self, taken_ns: int, value: float) -> float | None:
        """Slope of the least-squares line through the readings of `over_s`, with this one, per minute."""
        rates, over_ns = self._rates, to_ns(self._condition.over_s)
        index = bisect_right(rates, taken_ns, key=lambda one: one[0])
        apart_ns = over_ns // RATE_READINGS_MAX
        near = [each for each in rates[max(0, index - 1) : index + 1] if abs(each[0] - taken_ns) < apart_ns]
        if not near:
            rates.insert(index, (taken_ns, value))
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
