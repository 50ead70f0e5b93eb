"""Battery: state of charge by coulomb counting, remaining energy at the voltage of the moment."""

import msgspec

from robrain.agent.plugin import Unit, external
from robrain.plugins.device.bm2.interface import BatteryMeasurement, Bm2Interface
from robrain.protocol.wire.clock import to_seconds
from robrain.protocol.wire.messages import BatteryState

J_PER_WH = 3600.0


class Battery(Unit):
    """Counts energy out of the battery and tells what is left."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Values are chosen; set the capacity of the battery that is fitted."""

        capacity_wh: float = 20.0
        soc_at_start: float = 1.0

        def __post_init__(self) -> None:
            if self.capacity_wh <= 0:
                raise ValueError(f"expected capacity_wh > 0, got {self.capacity_wh}")
            if not 0 <= self.soc_at_start <= 1:
                raise ValueError(f"expected soc_at_start from 0 to 1, got {self.soc_at_start}")

    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self._capacity_j = self.parameters.capacity_wh * J_PER_WH
        self._remaining_j = self._capacity_j * self.parameters.soc_at_start
        self._last: BatteryMeasurement | None = None

    def activate(self) -> None:
        self._bm2 = self.env.use("bm2", Bm2Interface)

    def step(self) -> None:
        measured = self._bm2.latest()
        if measured is None or measured == self._last:
            return
        if self._last is not None:
            elapsed_s = to_seconds(measured.stamp_ns - self._last.stamp_ns)
            power_w = (measured.voltage_v * measured.current_a + self._last.voltage_v * self._last.current_a) / 2
            self._remaining_j = min(self._capacity_j, max(0.0, self._remaining_j - power_w * elapsed_s))
        self._last = measured
        self.env.board.battery = BatteryState(
            voltage_v=measured.voltage_v,
            current_a=measured.current_a,
            temperature_c=measured.temperature_c,
            soc=self._remaining_j / self._capacity_j,
            remaining_j=self._remaining_j,
        )

    @external
    def state(self) -> BatteryState | None:
        """Voltage, current, temperature, state of charge and remaining energy; null before the first measurement."""
        return self.env.board.battery
