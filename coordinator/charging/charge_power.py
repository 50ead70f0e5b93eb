"""What chargers put into batteries, as the robots that stand at them tell by and by."""

from typing import NamedTuple

from robrain.coordinator.charging.charge_schedule import is_same_charger
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.clock import to_ns, to_seconds
from robrain.protocol.wire.messages.robot_messages import BatteryState

USUAL_W = 20.0
"""Of a charger at which nobody has charged yet. Chosen: a dock of 40 W, less what a small robot draws itself, and what
the last part of a charge takes longer."""
LEAST_W = 1.0
"""A charger that gives less, or nothing, still ends a charge some day."""
WINDOW_NS = to_ns(10.0)
"""What has come in so long tells the power: batteries say what they hold with some noise."""
KEPT = 256


class _Begun(NamedTuple):
    charger: Point2D
    remaining_j: float
    stamp_ns: int


class ChargePower:
    """Learns the power of each charger; the last word counts."""

    def __init__(self) -> None:
        self._power_w: dict[Point2D, float] = {}
        self._begun: dict[str, _Begun] = {}

    def of(self, charger: Point2D) -> float:
        """Watts into the battery, above 0."""
        known = self._known(charger)
        return USUAL_W if known is None else self._power_w[known]

    def note(self, robot: str, charger: Point2D, battery: BatteryState, now_ns: int) -> None:
        """A robot stands at a charger and is charged."""
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

    def left(self, robot: str) -> None:
        """A robot is not charged any more."""
        self._begun.pop(robot, None)

    def _known(self, charger: Point2D) -> Point2D | None:
        return next((place for place in self._power_w if is_same_charger(place, charger)), None)
