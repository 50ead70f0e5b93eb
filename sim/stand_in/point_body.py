"""The body of a stand-in robot: a point that moves in a straight line, and a battery that drains by a linear model."""

import math
from collections.abc import Sequence

from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.energy_model import EnergyModel
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D

SPEED_M_S = 1.0
STANDING_W = 8.0
DRIVING_W = 20.0
"""In all, at `SPEED_M_S`."""
CHARGING_W = 200.0
CAPACITY_J = 8000.0
AT_CHARGER_M = 0.3
WATCHDOG_S = 0.5
"""Wheels stop this long after the last command."""
NOMINAL_V = 12.0
STANDING_MODEL = EnergyModel(
    coefficients=(STANDING_W, DRIVING_W - STANDING_W, 0.0, 0.0, 0.0),
    covariance=(0.0,) * 15,
    residual_w2_s=0.0,
    drift_w2_per_s=0.0,
    relative_sd=0.0,
    way_ratio=1.0,
    pace_m_s=SPEED_M_S,
    turn_rate_rad_s=3.0,
    packet_j=0.0,
    usable_j=CAPACITY_J,
    power_w=STANDING_W,
    usual_power_w=STANDING_W,
)


class PointBody:
    """What of a robot stays when its computer is switched off.

    Args:
        name: of the robot.
        place: where it stands, arena frame.
        chargers: places of the chargers; a charger serves any number of robots.
        soc: state of charge, 0 to 1.

    """

    def __init__(self, name: str, place: Point2D, chargers: Sequence[Point2D], soc: float = 1.0) -> None:
        self.name = name
        self.start = place
        self.place = place
        self.chargers = tuple(chargers)
        self.energy_j = soc * CAPACITY_J
        self.goal: Point2D | None = None
        self.work: tuple[str, int] | None = None
        """Id and epoch of the task that it is at; None if it is at none."""
        self.docked = False
        """Whether it stands at a charger."""
        self.moved_m = 0.0
        """Length of the last step."""
        self._uncommanded_s = 0.0

    @property
    def is_empty(self) -> bool:
        """Whether the battery gives nothing any more."""
        return self.energy_j <= 0.0

    @property
    def home_m(self) -> float:
        """Distance to the nearest charger."""
        return min((self.place.distance_m(charger) for charger in self.chargers), default=0.0)

    @property
    def nearest_charger(self) -> Point2D | None:
        """The nearest charger; None if there is none."""
        return min(self.chargers, key=self.place.distance_m, default=None)

    def command(self, goal: Point2D | None, work: tuple[str, int] | None) -> None:
        """Drive to a goal, or stand; to be repeated, for the wheels stop without commands."""
        self.goal, self.work, self._uncommanded_s = goal, work, 0.0

    def step(self, period_s: float) -> None:
        """Move on by one step."""
        self.moved_m = 0.0
        self._uncommanded_s += period_s
        if self._uncommanded_s > WATCHDOG_S:
            self.goal = self.work = None
        if self.goal is not None and not self.is_empty:
            self._move(self.goal, SPEED_M_S * period_s)
        power_w = DRIVING_W if self.moved_m > 0 else STANDING_W
        self.docked = self.home_m <= AT_CHARGER_M if self.chargers and not self.moved_m else False
        if self.docked:
            power_w -= CHARGING_W
        self.energy_j = min(CAPACITY_J, max(0.0, self.energy_j - power_w * period_s))

    def battery(self) -> BatteryState:
        """As its battery unit would tell."""
        energy_j = round(self.energy_j, 1)
        return BatteryState(
            voltage_v=NOMINAL_V,
            current_a=-CHARGING_W / NOMINAL_V if self.docked else STANDING_W / NOMINAL_V,
            temperature_c=22.0,
            soc=round(self.energy_j / CAPACITY_J, 4),
            remaining_j=energy_j,
            remaining_low_j=energy_j,
            remaining_high_j=energy_j,
            charging=self.docked,
        )

    def pose(self) -> Pose2D:
        """Its true pose, which it knows."""
        return Pose2D(self.place.x_m, self.place.y_m, 0.0)

    def velocity(self) -> Twist2D:
        """Its velocity along the way that it drives."""
        return Twist2D(forward_m_s=SPEED_M_S) if self.moved_m > 0 else Twist2D()

    def _move(self, goal: Point2D, reach_m: float) -> None:
        away_m = self.place.distance_m(goal)
        if away_m <= reach_m:
            self.place, self.moved_m = goal, away_m
            return
        share = reach_m / away_m
        x_m = self.place.x_m + share * (goal.x_m - self.place.x_m)
        y_m = self.place.y_m + share * (goal.y_m - self.place.y_m)
        self.place, self.moved_m = Point2D(x_m, y_m), reach_m


def drive_j(way_m: float, wait_s: float = 0.0) -> float:
    """Energy of a way, and of standing for a while."""
    return DRIVING_W * way_m / SPEED_M_S + STANDING_W * wait_s


def drive_s(way_m: float) -> float:
    """Duration of a way."""
    return way_m / SPEED_M_S if math.isfinite(way_m) else math.inf
