"""Wander: drives about at random, around obstacles; begun and ended from outside, and gives way to every task."""

import math

import numpy as np

from robrain.agent.plugin import Behavior, external
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.plugins.unit.driver.interface import DriverInterface, Motion
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Positive

STEP_S = 0.25
TRIES = 8
"""Number of directions drawn. The first with room for a whole leg is chosen, otherwise the one with the most room."""
BESIDE_RAD = math.radians(25.0)
"""The room ahead is that of the nearest thing within this of the direction."""
BLOCKED_S = 0.6


class WanderBehavior(Behavior):
    """A random walk."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """Chosen."""

        leg_m: Positive = 3.0
        """Longest path in one direction."""
        clear_m: Positive = 0.6
        """Distance before an obstacle at which a leg ends."""

    period_s: float | None = STEP_S
    parameters: Parameters

    def init(self) -> None:
        self._until_ns: int | None = None
        self._is_driving = False

    def activate(self) -> None:
        self._driver = self.env.use("driver", DriverInterface)
        self._scan = self.env.use("scan", ScanInterface)
        self.period_s = STEP_S

    def deactivate(self) -> None:
        self._end()

    def emergency_halt(self) -> None:
        self._until_ns = None
        self._is_driving = False

    @external
    def start(self, duration_s: float = 60.0) -> bool:
        """Wander for this time; False if the robot has a task or something else to finish."""
        if not 0 < duration_s < math.inf:
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"expected duration_s > 0, got {duration_s}")
        if not self.env.tasks.occupy(self.env.plugin):
            return False
        self._until_ns = self.env.clock.now_ns() + to_ns(duration_s)
        self.env.board.behavior = "wander"
        self.period_s = STEP_S
        self.env.hurry()  # its thread sleeps while the robot does not wander
        return True

    @external
    def stop(self) -> None:
        """Stop wandering."""
        self._end()

    @external
    def wandering(self) -> bool:
        """Whether the robot wanders."""
        return self._until_ns is not None

    def step(self) -> None:
        if self._until_ns is None:
            self.period_s = None
            return
        if not self.env.tasks.occupies(self.env.plugin):  # a task has come: the wheels are its own
            self._until_ns = None
            self._is_driving = False
            return
        if self.env.clock.now_ns() >= self._until_ns:
            self._end()
        elif not self._is_driving or self._driver.motion() is Motion.STOPPED or self._driver.blocked_s() > BLOCKED_S:
            self._next_leg()

    def _next_leg(self) -> None:
        scan = self._scan.latest()
        if scan is None:
            return
        best_rad, best_m = 0.0, 0.0
        for turn_rad in self.env.rng.uniform(-math.pi, math.pi, TRIES).tolist():
            room_m = _room_m(scan, turn_rad) - self.parameters.clear_m
            if room_m > best_m:
                best_rad, best_m = turn_rad, room_m
            if room_m >= self.parameters.leg_m:
                break
        if best_m <= 0.0:
            self._driver.turn(float(self.env.rng.uniform(-math.pi, math.pi)))  # boxed in: search elsewhere
            self._is_driving = True
            return
        leg_m = min(best_m, self.parameters.leg_m)
        pose = self._driver.pose()
        heading_rad = pose.yaw_rad + best_rad
        self._driver.follow(
            [Point2D(pose.x_m + leg_m * math.cos(heading_rad), pose.y_m + leg_m * math.sin(heading_rad))]
        )
        self._is_driving = True

    def _end(self) -> None:
        if self._until_ns is None:
            return
        self._until_ns = None
        self._is_driving = False
        if self.env.tasks.occupies(self.env.plugin):
            self._driver.stop()
            self.env.board.behavior = "idle"
        self.env.tasks.vacate(self.env.plugin)


def _room_m(scan: LaserScan, turn_rad: float) -> float:
    """Range of the nearest thing about a direction of the robot's frame."""
    aside_rad = np.abs((scan.angles_rad - turn_rad + math.pi) % math.tau - math.pi)
    ranges_m = scan.ranges_m[aside_rad < BESIDE_RAD]
    return float(ranges_m.min(initial=scan.range_max_m))
