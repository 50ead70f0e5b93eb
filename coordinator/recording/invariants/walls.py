"""No wall is crossed: by the ground truth, no footprint is inside a wall, at a truth or between two of them."""

import math
from collections.abc import Mapping

from robrain.coordinator.recording.invariants.findings import Invariant, InWall, Missing
from robrain.coordinator.recording.invariants.invariant_judge import Handler, InvariantJudge, Surroundings
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.wire.clock import to_seconds
from robrain.protocol.wire.messages.robots.robot_messages import RobotState
from robrain.protocol.wire.messages.team.arena_messages import ArenaTruth

DEPTH_M = 0.03
"""Least depth that is a breach: what a solver leaves of an overlap, and the raster of the floor (chosen)."""
CARRIED_M_S = 3.0
"""Nobody drives that fast: the robot was carried, and what is in between is not judged."""


class Walls(InvariantJudge):
    """Compares true poses with the floor."""

    invariant = Invariant.WALLS

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._radius_m: dict[str, float] = {}
        self._inside: set[str] = set()
        self._last: dict[str, tuple[Pose2D, int]] = {}
        self._has_truth = False

    def handlers(self) -> Mapping[type, Handler]:
        """What is to be called with each type of message."""
        return {RobotState: self._take_state, ArenaTruth: self._take_truth}

    def lacks(self) -> Missing | None:
        """What the messages lacked."""
        if not self._has_truth:
            return Missing.TRUTH
        if self.surroundings.clearance_m is None:
            return self.surroundings.no_floor
        return None if self.cases else Missing.RADIUS

    def _take_state(self, state: RobotState, _time_ns: int) -> None:
        if state.radius_m > 0:
            self._radius_m[state.robot] = state.radius_m

    def _take_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        self._has_truth = True
        if self.surroundings.clearance_m is None:
            return
        for robot in truth.robots:
            radius_m = self._radius_m.get(robot.robot)
            if radius_m is not None:
                self.cases += 1
                self._judge(robot.robot, radius_m, robot.pose, time_ns)
                self._last[robot.robot] = robot.pose, time_ns

    def _judge(self, robot: str, radius_m: float, pose: Pose2D, time_ns: int) -> None:
        clearance_m = self.surroundings.clearance_m
        assert clearance_m is not None
        depth_m, place = -math.inf, Point2D(pose.x_m, pose.y_m)
        for at in self._way(robot, radius_m, pose, time_ns):
            if (deep_m := radius_m - clearance_m(at.x_m, at.y_m)) > depth_m:
                depth_m, place = deep_m, at
        if depth_m <= DEPTH_M:
            self._inside.discard(robot)
        elif robot not in self._inside:
            self._inside.add(robot)
            self.break_(time_ns, InWall(robot=robot, place=place, depth_m=round(depth_m, 4)))

    def _way(self, robot: str, radius_m: float, pose: Pose2D, time_ns: int) -> list[Point2D]:
        """The place, and before it those on the way there that are a radius apart: no wall fits between them."""
        end = Point2D(pose.x_m, pose.y_m)
        last = self._last.get(robot)
        if last is None:
            return [end]
        (begin, begin_ns), way_m = last, last[0].distance_m(end)
        if way_m <= radius_m or way_m > CARRIED_M_S * to_seconds(time_ns - begin_ns):
            return [end]
        steps = math.ceil(way_m / radius_m)
        return [
            Point2D(begin.x_m + (end.x_m - begin.x_m) * step / steps, begin.y_m + (end.y_m - begin.y_m) * step / steps)
            for step in range(1, steps + 1)
        ]
