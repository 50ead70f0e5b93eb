"""Battery of a point: it has exact knowledge of its charge."""

from robrain.agent.event import Event
from robrain.agent.plugin import Unit, external
from robrain.algorithms.energy.consumption import Drawn
from robrain.plugins.unit.battery import Battery, BatteryAlarm, BatteryInterface
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.sim.firmware.battery import NOMINAL_V
from robrain.sim.points.point_team import POINT_TICK_S, robot_of


class PointBattery(Unit):
    """Reports the remaining energy, and warns when it is low."""

    Parameters = Battery.Parameters
    interface = BatteryInterface
    period_s = POINT_TICK_S
    parameters: Battery.Parameters
    low = Event[BatteryAlarm](outside=True)
    cut_off = Event[BatteryAlarm](outside=True)
    implausible = Event[BatteryAlarm](outside=True)

    def init(self) -> None:
        self._robot = robot_of(self.env)
        self._is_low = self._is_cut_off = False

    def activate(self) -> None:
        self.step()

    def step(self) -> None:
        robot = self._robot
        soc, energy_j = robot.soc, round(robot.energy_j, 1)
        self.env.board.battery = BatteryState(
            voltage_v=NOMINAL_V,
            current_a=round((robot.power_w - robot.supply_w) / NOMINAL_V, 3),
            temperature_c=22.0,
            soc=round(soc, 5),
            remaining_j=energy_j,
            remaining_low_j=energy_j,
            remaining_high_j=energy_j,
            charging=robot.supply_w > robot.power_w,
        )
        limits = self.parameters
        self._is_low = self._warn(self.low, soc, limits.low_soc, is_warned=self._is_low)
        self._is_cut_off = self._warn(self.cut_off, soc, limits.cut_off_soc, is_warned=self._is_cut_off)

    @external
    def state(self) -> BatteryState | None:
        """Voltage, current, charge and remaining energy."""
        return self.env.board.battery

    def drawn(self) -> Drawn | None:
        """Energy drawn so far."""
        robot = self._robot
        return Drawn(self.env.clock.now_ns(), robot.delivered_j, trusted=not robot.supply_w)

    def _warn(self, event: Event[BatteryAlarm], soc: float, limit_soc: float, *, is_warned: bool) -> bool:
        """Notify once when the charge falls to a limit; returns whether that has been done."""
        if soc > limit_soc:
            return is_warned and soc <= limit_soc + self.parameters.hysteresis_soc
        if not is_warned:
            reason = f"{100 * soc:.0f} % left, the limit is {100 * limit_soc:g} %"
            event.notify(BatteryAlarm(reason, soc, self._robot.energy_j, NOMINAL_V))
        return True
