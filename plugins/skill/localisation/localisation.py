"""Localisation by dead reckoning from a known start: T_arena_robot = T_arena_odom · T_odom_robot."""

import math

import msgspec

from robrain.agent.plugin import Skill, external
from robrain.plugins.skill.localisation.interface import LocalisationInterface
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.protocol.model.geometry import Point2D, Pose2D


class Localisation(Skill):
    """Tells the team where the robot is."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Where the robot starts, arena frame."""

        x_m: float = 0.0
        y_m: float = 0.0
        yaw_rad: float = 0.0

    interface = LocalisationInterface
    period_s = 0.1
    parameters: Parameters

    def activate(self) -> None:
        self._driver = self.env.use("driver", DriverInterface)
        start = self.parameters
        self._T_arena_odom = Pose2D(start.x_m, start.y_m, start.yaw_rad)
        self.env.board.T_arena_odom = self._T_arena_odom
        self.env.board.radius_m = self._driver.radius_m()

    def step(self) -> None:
        board = self.env.board
        board.pose = self.pose()
        board.velocity = self._driver.velocity()

    @external
    def pose(self) -> Pose2D:
        """T_arena_robot now."""
        return self._T_arena_odom.compose(self._driver.pose())

    def to_odom(self, points: list[Point2D]) -> list[Point2D]:
        """Points of the arena frame in the frame odom."""
        T_odom_arena = self._T_arena_odom.inverse()
        cos, sin = math.cos(T_odom_arena.yaw_rad), math.sin(T_odom_arena.yaw_rad)
        return [
            Point2D(
                T_odom_arena.x_m + cos * point.x_m - sin * point.y_m,
                T_odom_arena.y_m + sin * point.x_m + cos * point.y_m,
            )
            for point in points
        ]
