"""A leg: one path that is being driven, as far as others let the robot, and what the team is told of it."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from robrain.plugins.behavior.encounter import Encounter
from robrain.plugins.skill.localisation.interface import LocalisationInterface
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.navigation.claim import Claim
from robrain.protocol.model.navigation.right_of_way import LOOK_AHEAD_M, STEP_M, Release, Way
from robrain.protocol.wire.messages.robot_messages import PlannedPath

NEAR_END_M = 0.3
"""The driver is told of more released way when there is so much of it, or when it comes so near to the end."""


class Outlet(NamedTuple):
    """Where a leg goes: to the driver, and to the team."""

    robot: str
    speed_m_s: float
    driver: DriverInterface
    localisation: LocalisationInterface
    publish: Callable[[PlannedPath], None]


class Leg:
    """A path from where the robot is.

    Args:
        outlet: who is told.
        pose: T_arena_robot now.
        path: points to drive along, arena frame, at least one.
        is_escape: whether it leads out of others' way instead of to the goal.
        is_narrow: whether it leads through narrow places, where the robot has to squeeze.

    """

    def __init__(
        self,
        outlet: Outlet,
        pose: Pose2D,
        path: list[Point2D],
        *,
        is_escape: bool = False,
        is_narrow: bool = False,
    ) -> None:
        self.is_escape = is_escape
        self.is_narrow = is_narrow
        self.way = Way(np.array([(pose.x_m, pose.y_m), *((point.x_m, point.y_m) for point in path)]))
        self.end = path[-1]
        self._outlet = outlet
        self._released_m = -1.0
        """How far along it the driver has been sent; below 0 for not at all."""
        self._told: tuple[Claim, float | None] | None = None

    def guard(self, encounter: Encounter, pose: Pose2D) -> Release:
        """How far the robot may go along it without touching anybody."""
        return encounter.guard(self.way.ahead(pose.x_m, pose.y_m, LOOK_AHEAD_M))

    def drive(self, allowed: Release, claim: Claim) -> None:
        """Go as far as that, and tell the team."""
        way = self.way
        if allowed.is_whole:
            if self._released_m < way.length_m:
                self._send(way.length_m)
            self._tell(claim, None)
        elif allowed.positions < 2:
            self.stop(claim)
        else:
            until_m = way.passed_m + (allowed.positions - 1) * STEP_M
            more_m = until_m - self._released_m
            is_near_end = self._released_m - way.passed_m < NEAR_END_M
            if more_m < 0 or more_m > NEAR_END_M or (is_near_end and more_m > 0.5 * STEP_M):
                self._send(until_m)
            self._tell(claim, until_m)

    def stop(self, claim: Claim) -> None:
        """Stand, and tell the team that the robot waits."""
        if self._released_m != self.way.passed_m:
            self._outlet.driver.stop()
            self._released_m = self.way.passed_m
        self._tell(claim, self.way.passed_m)

    def cut(self, pose: Pose2D, more_m: float) -> "Leg | None":
        """What is left of it in that distance, as far as the robot was sent; None if that is nothing."""
        until_m = min(self._released_m, self.way.passed_m + more_m)
        if until_m <= self.way.passed_m:
            return None
        return Leg(self._outlet, pose, _points(self.way, until_m), is_narrow=self.is_narrow)

    def _send(self, until_m: float) -> None:
        self._released_m = until_m
        path = self._outlet.localisation.to_odom(_points(self.way, until_m))
        self._outlet.driver.follow(path, is_narrow=self.is_narrow)

    def _tell(self, claim: Claim, until_m: float | None) -> None:
        """Publish the path, if anything about it is new."""
        word = claim, None if until_m is None else round(2.0 * until_m) / 2.0
        if word == self._told:
            return
        self._told = word
        way, outlet = self.way, self._outlet
        pose = outlet.localisation.pose()
        outlet.publish(
            PlannedPath(
                robot=outlet.robot,
                points=[Point2D(pose.x_m, pose.y_m), *_points(way, math.inf)],
                claim=claim,
                speed_m_s=outlet.speed_m_s,
                held_at_m=None if until_m is None else max(0.0, until_m - way.passed_m),
            )
        )


def _points(way: Way, until_m: float) -> list[Point2D]:
    return [Point2D(float(x_m), float(y_m)) for x_m, y_m in way.points_until(until_m)]
