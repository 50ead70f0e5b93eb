"""Learns the power of chargers from the batteries of the robots that charge."""

from typing import NamedTuple

from robrain.coordinator.team.chargers import is_same_charger
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.geometry import Point2D

USUAL_W = 20.0
"""Of a charger at which no robot has charged yet. Chosen: a dock of 40 W, less a small robot's own consumption and the
slower last part of a charge."""
LEAST_W = 1.0
"""Lower bound of a learned power, so that every charge has an end."""
WINDOW_NS = to_ns(10.0)
"""Interval over which the power is measured, against noise in the reported energy."""
KEPT = 256


class _Begun(NamedTuple):
    charger: Point2D
    remaining_j: float
    stamp_ns: int


class ChargePower:
    """Learns the power of each charger; the latest measurement counts."""

    def __init__(self) -> None:
        self._power_w: dict[Point2D, float] = {}
        self._begun: dict[str, _Begun] = {}

    def of(self, charger: Point2D) -> float:
        """Power into the battery in watts, above 0."""
        known = self._known(charger)
        return USUAL_W if known is None else self._power_w[known]

    def record(self, robot: str, charger: Point2D, battery: BatteryState, now_ns: int) -> None:
        """Record a battery state of a robot that is charged at a charger."""
        begun = self._begun.get(robot)
        if begun is None or not is_same_charger(begun.charger, charger):
            self._begun[robot] = _Begun(charger, battery.remaining_j, now_ns)
        elif now_ns - begun.stamp_ns >= WINDOW_NS:
            power_w = (battery.remaining_j - begun.remaining_j) / to_seconds(now_ns - begun.stamp_ns)
            known = self._known(charger)
            self._power_w[charger if known is None else known] = max(LEAST_W, power_w)
            while len(self._power_w) > KEPT:
                del self._power_w[next(iter(self._power_w))]
            self._begun[robot] = _Begun(charger, battery.remaining_j, now_ns)

    def stop(self, robot: str) -> None:
        """A robot is no longer charged."""
        self._begun.pop(robot, None)

    def _known(self, charger: Point2D) -> Point2D | None:
        return next((place for place in self._power_w if is_same_charger(place, charger)), None)
