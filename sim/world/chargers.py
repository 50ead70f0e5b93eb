"""Chargers: docks on the floor that charge the robot at them."""

import math
from collections.abc import Sequence

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive
from robrain.sim.robot.robot_body import Body

AT_REST_BELOW_M_S = 0.05
"""A robot that passes by is not charged; contacts must rest on each other."""


class ChargerSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[chargers]]`: one charger. Raises ValueError for impossible values."""

    place_m: tuple[float, float]
    """Place of a docked robot's centre, arena frame."""
    yaw_rad: float | None = None
    """Direction that a docking robot should face; the contacts work in any direction."""
    power_w: Positive = 40.0
    """Greatest power, including the robot's own consumption. Chosen: an hour of charging lasts for two hours."""
    reach_m: Positive = 0.25
    """Greatest distance from the place at which a robot touches the contacts."""


class Chargers:
    """All docks of the arena and the robots at them. A dock charges one robot at a time, the first one there.

    Args:
        specs: the docks; a robot within reach of two uses the first free one in this order.
        tick_s: duration of a tick.

    """

    def __init__(self, specs: Sequence[ChargerSpec], tick_s: float) -> None:
        self._specs = specs
        self._step_m = AT_REST_BELOW_M_S * tick_s
        self.docked: list[int | None] = [None] * len(specs)
        """For each charger the index of the robot that it feeds."""

    def supplies_w(self, bodies: Sequence[Body]) -> list[float]:
        """Power supplied to each robot now."""
        supplies = [0.0] * len(bodies)
        for number, spec in enumerate(self._specs):
            robot = self.docked[number]
            if robot is None or not self._touches(spec, bodies[robot]):
                self.docked[number] = robot = self._first_at(spec, bodies)
            if robot is not None:
                supplies[robot] = spec.power_w
        return supplies

    def _first_at(self, spec: ChargerSpec, bodies: Sequence[Body]) -> int | None:
        (x_m, y_m), reach_m = spec.place_m, spec.reach_m
        for index, body in enumerate(bodies):
            # Most are far away, which costs no call to find out.
            is_near = abs(body.x_m - x_m) <= reach_m and abs(body.y_m - y_m) <= reach_m
            if is_near and index not in self.docked and self._touches(spec, body):
                return index
        return None

    def _touches(self, spec: ChargerSpec, body: Body) -> bool:
        is_at_rest = math.hypot(body.forward_m, body.left_m) < self._step_m
        x_m, y_m = spec.place_m
        return is_at_rest and math.hypot(body.x_m - x_m, body.y_m - y_m) <= spec.reach_m
