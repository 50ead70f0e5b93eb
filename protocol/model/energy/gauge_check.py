"""Whether a battery's measurements can be believed: each is held against the one before and against the estimate.

No measurement is believed for as long as anything is wrong, and for some seconds after: an estimate that goes on by
itself and says how unsure it is serves better than one that follows a lie.
"""

import math

import msgspec


class GaugeLimits(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a sound gauge never says. Chosen for four lithium-ion cells; raises ValueError where it is not above 0."""

    voltage_min_v: float = 8.0
    voltage_max_v: float = 17.5
    current_max_a: float = 15.0
    temperature_min_c: float = -30.0
    temperature_max_c: float = 75.0
    jump_v: float = 0.4
    """Change of voltage between two measurements, beyond what the change of current explains."""
    contradiction_v: float = 0.3
    """Distance between the voltage and what the estimate expects at this current, as a mean over `contradiction_s`."""
    contradiction_s: float = 3.0
    awake_min_a: float = 0.08
    """The computer that runs this draws more than that; only a charger can make it less."""
    awake_s: float = 5.0
    frozen_s: float = 4.0
    """Voltage and current are the same to the last bit for no longer than this; more for a gauge that averages."""
    stale_s: float = 1.5
    """So long without a measurement is a fault."""
    recover_s: float = 10.0
    """So long everything has to be right again."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            if not name.startswith("temperature") and not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")
        if not self.voltage_min_v < self.voltage_max_v:
            raise ValueError(f"expected voltage_max_v above voltage_min_v, got {self.voltage_max_v}")


class GaugeCheck:
    """Judges one measurement after the other.

    Args:
        limits: what a sound gauge never says.

    """

    def __init__(self, limits: GaugeLimits) -> None:
        self.limits = limits
        self.why = ""
        """What is wrong, in words; empty while the gauge is believed."""
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
    ) -> bool:
        """Whether to believe this measurement.

        Args:
            voltage_v: as measured, like the next two.
            current_a: positive while discharging.
            temperature_c: of the pack.
            since_s: time since the measurement before.
            expected_v: what the estimate expects at this current.
            resistance_ohm: as estimated.

        """
        wrong = self._wrong(voltage_v, current_a, temperature_c, since_s, expected_v, resistance_ohm)
        self._voltage_v, self._current_a = voltage_v, current_a
        return self._settle(wrong, since_s)

    def silent(self, since_s: float, elapsed_s: float) -> bool:
        """Whether it still is to be believed after `since_s` without a measurement; `elapsed_s` since asked last."""
        is_stale = since_s > self.limits.stale_s
        return self._settle(f"no measurement for {since_s:.1f} s", elapsed_s) if is_stale else not self.why

    def _settle(self, wrong: str, elapsed_s: float) -> bool:
        if wrong:
            self.why = wrong
            self._right_s = 0.0
        elif self.why:
            self._right_s += min(elapsed_s, self.limits.stale_s)  # one measurement after a silence proves little
            if self._right_s >= self.limits.recover_s:
                self.why = ""
        return not self.why

    def _wrong(
        self,
        voltage_v: float,
        current_a: float,
        temperature_c: float,
        since_s: float,
        expected_v: float,
        resistance_ohm: float,
    ) -> str:
        limits = self.limits
        if not limits.voltage_min_v <= voltage_v <= limits.voltage_max_v:
            return f"{voltage_v:.2f} V is out of range"
        if not abs(current_a) <= limits.current_max_a:
            return f"{current_a:.2f} A is out of range"
        if not limits.temperature_min_c <= temperature_c <= limits.temperature_max_c:
            return f"{temperature_c:.0f} degrees are out of range"

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
