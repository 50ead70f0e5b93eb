"""Tracks one battery by its measurements: believed ones correct the estimate, others widen it.

Each measurement is compared with the one before and with the estimate. While anything is wrong, and for some seconds
after, no measurement is believed. An estimate that continues alone and reports its uncertainty is better than one that
follows a false measurement.
"""

import math
from typing import NamedTuple

from robrain.algorithms.energy.battery_report import NOTHING_MORE, BatteryReport
from robrain.algorithms.energy.soc_filter import PackModel, SocFilter
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive

USUAL_OVER_S = 60.0
DOUBT_AT_ONCE = 0.05
"""Added to the deviation of the state of charge when a false measurement is noticed: earlier ones may be false too.
Chosen."""
SNAPSHOT_S = 6.0
"""Measurements believed in the last 6 to 12 s are discarded when a false one is noticed. This is longer than noticing
takes."""
DOUBT_SHARE = 0.5
"""Uncertainty of the current while it is not measured, as a share of the usual one. Chosen."""
KNOWN_START_SD = 0.02


class GaugeLimits(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits that a sound gauge never exceeds.

    Chosen for four lithium-ion cells; raises ValueError where it is not above 0.
    """

    voltage_min_v: Positive = 8.0
    voltage_max_v: Positive = 17.5
    current_max_a: Positive = 15.0
    temperature_min_c: float = -30.0
    temperature_max_c: float = 75.0
    jump_v: Positive = 0.4
    """Change of voltage between two measurements, beyond the effect of the change of current."""
    contradiction_v: Positive = 0.3
    """Distance between the voltage and its estimate at this current, as a mean over `contradiction_s`."""
    contradiction_s: Positive = 3.0
    awake_min_a: Positive = 0.08
    """The computer that runs this draws more than that; only a charger can make it less."""
    awake_s: Positive = 5.0
    frozen_s: Positive = 4.0
    """Voltage and current are the same to the last bit for no longer than this; more for a gauge that averages."""
    stale_s: Positive = 1.5
    """Time without a measurement that is a fault."""
    recover_s: Positive = 10.0
    """Time for which all measurements must be right again."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.voltage_min_v < self.voltage_max_v:
            raise ValueError(f"expected voltage_max_v above voltage_min_v, got {self.voltage_max_v}")


class GaugeCheck:
    """Judges one measurement after the other.

    Args:
        limits: limits of a sound gauge.

    """

    def __init__(self, limits: GaugeLimits) -> None:
        self.limits = limits
        self.reason = ""
        """Reason for doubt, in words; empty while the gauge is believed."""
        self._voltage_v = math.nan
        self._current_a = math.nan
        self._same_s = 0.0
        self._asleep_s = 0.0
        self._may_be_fed = True
        """A charger may feed the robot, so that no current is no wonder: until the battery is seen to discharge."""
        self._off_v = 0.0
        self._right_s = 0.0

    def judge(
        self,
        voltage_v: float,
        current_a: float,
        temperature_c: float,
        since_s: float,
        expected_v: float,
        resistance_ohm: float,
        *,
        compares: bool = True,
    ) -> bool:
        """Whether to believe this measurement.

        Args:
            voltage_v: measured voltage.
            current_a: measured current, positive while discharging.
            temperature_c: measured temperature of the pack.
            since_s: time since the previous measurement.
            expected_v: estimated voltage at this current.
            resistance_ohm: estimated resistance.
            compares: whether to compare voltage and current with each other and with the estimate.

        """
        wrong = self._out_of_range(voltage_v, current_a, temperature_c)
        if not wrong and compares:
            wrong = self._contradiction(voltage_v, current_a, since_s, expected_v, resistance_ohm)
        self._voltage_v, self._current_a = voltage_v, current_a
        return self._settle(wrong, since_s)

    def silent(self, since_s: float, elapsed_s: float) -> bool:
        """Whether it is still believed after `since_s` without a measurement; `elapsed_s` since the last call."""
        is_stale = since_s > self.limits.stale_s
        return self._settle(f"no measurement for {since_s:.1f} s", elapsed_s) if is_stale else not self.reason

    def _settle(self, wrong: str, elapsed_s: float) -> bool:
        if wrong:
            self.reason = wrong
            self._right_s = 0.0
        elif self.reason:
            self._right_s += min(elapsed_s, self.limits.stale_s)  # one measurement after a silence proves little
            if self._right_s >= self.limits.recover_s:
                self.reason = ""
        return not self.reason

    def _out_of_range(self, voltage_v: float, current_a: float, temperature_c: float) -> str:
        limits = self.limits
        if not limits.voltage_min_v <= voltage_v <= limits.voltage_max_v:
            return f"{voltage_v:.2f} V is out of range"
        if not abs(current_a) <= limits.current_max_a:
            return f"{current_a:.2f} A is out of range"
        if not limits.temperature_min_c <= temperature_c <= limits.temperature_max_c:
            return f"{temperature_c:.0f} degrees are out of range"
        return ""

    def _contradiction(
        self, voltage_v: float, current_a: float, since_s: float, expected_v: float, resistance_ohm: float
    ) -> str:
        limits = self.limits
        same = voltage_v == self._voltage_v and current_a == self._current_a
        self._same_s = self._same_s + since_s if same else 0.0
        if self._same_s >= limits.frozen_s:
            return f"frozen at {voltage_v:.3f} V and {current_a:.3f} A"

        unexplained_v = voltage_v - self._voltage_v + resistance_ohm * (current_a - self._current_a)
        if abs(unexplained_v) > limits.jump_v and since_s <= limits.stale_s:
            return f"the voltage jumped by {unexplained_v:+.2f} V"

        is_asleep = abs(current_a) < limits.awake_min_a
        self._asleep_s = self._asleep_s + since_s if is_asleep else 0.0
        if not is_asleep:
            self._may_be_fed = current_a < 0
        if self._asleep_s >= limits.awake_s and not self._may_be_fed:
            return f"{current_a:.2f} A cannot be: the computer runs, and no charger feeds it"

        share = min(1.0, since_s / limits.contradiction_s)
        off_v = min(2.0, max(-2.0, voltage_v - expected_v))
        self._off_v += share * (off_v - self._off_v)
        if abs(self._off_v) > limits.contradiction_v:
            return f"{voltage_v:.2f} V contradicts {current_a:.2f} A: {voltage_v - self._off_v:.2f} V expected"
        return ""


class TrackedReading(NamedTuple):
    """One measurement; current is positive while discharging."""

    voltage_v: float
    current_a: float
    temperature_c: float


class BatteryTracker:
    """A filter behind a check.

    Args:
        pack: datasheet of the battery.
        limits: limits of its gauge when it is sound.
        soc_at_start: taken from the voltage if None.

    """

    def __init__(self, pack: PackModel, limits: GaugeLimits, soc_at_start: float | None = None) -> None:
        self.filter = SocFilter(pack)
        self.usual_a = pack.drive_current_a
        """Mean of the current that is drawn, over a minute."""
        self._check = GaugeCheck(limits)
        self._soc_at_start = soc_at_start
        self._was_believed = True
        self._older = self._newer = self.filter.snapshot()
        self._older_s = self._newer_s = 0.0
        self._blind_s = 0.0
        """Part of the time since the last measurement that was counted already."""

    @property
    def doubt_reason(self) -> str:
        """Reason to doubt the measurements, in words; empty while they are believed."""
        return self._check.reason

    def begin(self, measured: TrackedReading, report: BatteryReport = NOTHING_MORE) -> None:
        """The first measurement."""
        self._check.judge(*measured, 0.0, measured.voltage_v, 0.0, compares=report.is_plain)
        if self._soc_at_start is not None:
            self.filter.start_at(self._soc_at_start, KNOWN_START_SD)
        elif self.doubt_reason:
            self.filter.start_at(0.5, 0.3)
        elif report.soc is not None:
            self.filter.start_at(report.soc, report.soc_sd)
        else:
            self.filter.start_from(measured.voltage_v, measured.current_a)
        self._older = self._newer = self.filter.snapshot()

    def follow(
        self, measured: TrackedReading, counted_c: float, elapsed_s: float, report: BatteryReport = NOTHING_MORE
    ) -> None:
        """A measurement `elapsed_s` (above 0) after the one before, with the charge that has flown since."""
        blind_s, self._blind_s = self._blind_s, 0.0
        expected_v = self.filter.expected_v(measured.current_a)
        resistance_ohm = self.filter.resistance_ohm
        if not self._check.judge(*measured, elapsed_s, expected_v, resistance_ohm, compares=report.is_plain):
            self._extrapolate(max(0.0, elapsed_s - blind_s))
            return
        self._was_believed = True
        self._keep(elapsed_s)
        self._correct(measured, counted_c / elapsed_s, elapsed_s, report)
        if measured.current_a > 0 and report.has_current:
            self.usual_a += min(1.0, elapsed_s / USUAL_OVER_S) * (measured.current_a - self.usual_a)

    def _correct(self, measured: TrackedReading, mean_a: float, elapsed_s: float, report: BatteryReport) -> None:
        believed = self.filter
        unsure_a = DOUBT_SHARE * max(abs(mean_a), self.usual_a)
        if report.has_current:
            believed.count(mean_a, elapsed_s)
        else:
            believed.count_guess(mean_a, unsure_a, elapsed_s)
        if report.soc is not None:  # the battery knows its own cells; the curve of the datasheet may be any
            believed.fuse_soc(report.soc, report.soc_sd, elapsed_s)
        elif report.has_current:
            believed.fuse(measured.voltage_v, measured.current_a)
        else:
            believed.fuse_at_guess(measured.voltage_v, mean_a, unsure_a, elapsed_s)

    def no_reading(self, since_s: float, elapsed_s: float) -> None:
        """No measurement has come for `since_s`; `elapsed_s` have passed since the last call of this or `follow`."""
        if not self._check.silent(since_s, elapsed_s):
            self._extrapolate(elapsed_s)
            self._blind_s += elapsed_s

    def _extrapolate(self, elapsed_s: float) -> None:
        if self._was_believed:
            self._was_believed = False
            self.filter.restore(self._older)
            self.filter.doubt(DOUBT_AT_ONCE)
            elapsed_s += self._older_s
            self._older_s = self._newer_s = 0.0
        self.filter.count(self.usual_a, elapsed_s)
        capacity_c = self.filter.rated_c * self.filter.health
        self.filter.doubt(DOUBT_SHARE * self.usual_a * elapsed_s / capacity_c)
        self._older = self._newer = self.filter.snapshot()

    def _keep(self, elapsed_s: float) -> None:
        self._older_s += elapsed_s
        self._newer_s += elapsed_s
        if self._newer_s >= SNAPSHOT_S:
            self._older, self._older_s = self._newer, self._newer_s
            self._newer, self._newer_s = self.filter.snapshot(), elapsed_s  # from before this measurement
