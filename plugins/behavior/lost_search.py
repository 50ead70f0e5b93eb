"""Search of a lost robot for its place: it drives about slowly, bound for nowhere."""

import math

from robrain.plugins.unit.driver.interface import DriverInterface, Motion
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Point2D

SPEED_M_S = 0.25
LEG_M = 1.5
CORNER_RAD = math.radians(100.0)
"""From one leg to the next: after seven of them all directions have been gone in, and no two lie in line."""
ASIDE_RAD = math.radians(137.5)
"""From a leg that is blocked to the next, the golden angle: the directions tried spread out evenly."""
BLOCKED_S = 0.6
PATIENCE_S = 120.0
"""Chosen: some 25 m of path. A robot that is still lost after this time stays lost."""
TASK_PATIENCE_S = 15.0
"""Time that a task waits for a robot that maps in its own frame. After it, other robots do the task, and this robot may
explore."""


class LostSearch:
    """One robot's search; made when it is lost, stepped until it is not.

    Args:
        driver: the plugins with which it drives.
        now_ns: when it begins.

    """

    def __init__(self, driver: DriverInterface, now_ns: int) -> None:
        self._driver = driver
        self._since_ns = now_ns
        self._heading_rad = driver.pose().yaw_rad
        self._is_at_it = False
        self.has_given_up = False

    def step(self, now_ns: int, patience_s: float = PATIENCE_S) -> None:
        """Continue, or stop for good after this time of searching."""
        if self.has_given_up:
            return
        if now_ns >= self._since_ns + to_ns(patience_s):
            self.has_given_up = True
            self._driver.stop()
            return
        if self._is_at_it and self._driver.motion() is not Motion.STOPPED:
            if self._driver.blocked_s() < BLOCKED_S:
                return
            self._heading_rad += ASIDE_RAD
        elif self._is_at_it:
            self._heading_rad += CORNER_RAD
        self._is_at_it = True
        pose = self._driver.pose()
        end = Point2D(pose.x_m + LEG_M * math.cos(self._heading_rad), pose.y_m + LEG_M * math.sin(self._heading_rad))
        self._driver.follow([end], SPEED_M_S)
