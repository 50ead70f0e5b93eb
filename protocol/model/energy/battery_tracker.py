"""Following one battery through its measurements: those that are believed correct the estimate, the others widen it."""

from typing import NamedTuple

from robrain.protocol.model.energy.gauge_check import GaugeCheck, GaugeLimits
from robrain.protocol.model.energy.soc_filter import PackModel, SocFilter

USUAL_OVER_S = 60.0
DOUBT_AT_ONCE = 0.05
"""Added to the deviation of the state of charge when a lie is noticed: it may have gone on for a while. Chosen."""
SNAPSHOT_S = 6.0
"""What was believed in the last 6 to 12 s is forgotten when a lie is noticed: longer than it takes to notice one."""
DOUBT_SHARE = 0.5
"""Unsureness of the current while nobody measures it, as a share of the usual one. Chosen."""
KNOWN_START_SD = 0.02


class Measured(NamedTuple):
    """One measurement; current is positive while discharging."""

    voltage_v: float
    current_a: float
    temperature_c: float


class BatteryTracker:
    """A filter behind a check.

    Args:
        pack: datasheet of the battery.
        limits: what its gauge never says when it is sound.
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
        """Of the time since the last measurement, what has been counted on already."""

    @property
    def why_doubted(self) -> str:
        """What is wrong with the measurements, in words; empty while they are believed."""
        return self._check.why

    def begin(self, measured: Measured) -> None:
        """The first measurement."""
        self._check.judge(*measured, 0.0, measured.voltage_v, 0.0)
        if self._soc_at_start is not None:
            self.filter.start_at(self._soc_at_start, KNOWN_START_SD)
        elif self.why_doubted:
            self.filter.start_at(0.5, 0.3)
        else:
            self.filter.start_from(measured.voltage_v, measured.current_a)
        self._older = self._newer = self.filter.snapshot()

    def follow(self, measured: Measured, counted_c: float, elapsed_s: float) -> None:
        """A measurement `elapsed_s` (above 0) after the one before, with the charge that has flown since."""
        blind_s, self._blind_s = self._blind_s, 0.0
        expected_v = self.filter.expected_v(measured.current_a)
        if not self._check.judge(*measured, elapsed_s, expected_v, self.filter.resistance_ohm):
            self._go_on_blindly(max(0.0, elapsed_s - blind_s))
            return
        self._was_believed = True
        self._keep(elapsed_s)
        self.filter.count(counted_c / elapsed_s, elapsed_s)
        self.filter.fuse(measured.voltage_v, measured.current_a)
        if measured.current_a > 0:
            self.usual_a += min(1.0, elapsed_s / USUAL_OVER_S) * (measured.current_a - self.usual_a)

    def hear_nothing(self, since_s: float, elapsed_s: float) -> None:
        """No measurement has come for `since_s`; `elapsed_s` have passed since the last call of this or `follow`."""
        if not self._check.silent(since_s, elapsed_s):
            self._go_on_blindly(elapsed_s)
            self._blind_s += elapsed_s

    def _go_on_blindly(self, elapsed_s: float) -> None:
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
