"""Follow: stays near a robot or a point that moves."""

from robrain.agent.plugin import external
from robrain.plugins.behavior.errand import Errand, Failed, Run, Script
from robrain.plugins.behavior.travel import TROUBLE, TravelParameters
from robrain.plugins.skill.energy import Work
from robrain.plugins.unit.teammates import TeammatesInterface
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.model.geometry import Point2D, point_along
from robrain.protocol.model.tasks.stock_kinds import FOLLOW, Follow
from robrain.protocol.model.tasks.task import Task

TARGET_MOVED_M = 0.3
"""A robot that follows plans again when its target has moved so far."""
LOST_TARGET_S = 20.0
"""Time after which a robot gives up a target that it no longer receives."""


class FollowBehavior(Errand[Follow]):
    """Follows a robot or a point."""

    kind = FOLLOW
    parameters: TravelParameters

    def activate(self) -> None:
        self._teammates = self.env.use("teammates", TeammatesInterface)
        self._point: Point2D | None = None
        super().activate()

    @external
    def point(self, x_m: float, y_m: float) -> None:
        """Move the point that the robot follows, arena frame."""
        self._point = Point2D(x_m, y_m)

    def work(self, task: Task, follow: Follow) -> Work:
        """At the most it drives all the time."""
        return Work(path_m=self.parameters.speed_m_s * follow.duration_s)

    def left_s(self, run: Run[Follow]) -> float | None:
        """The rest of its time."""
        if run.there_ns is None:
            return super().left_s(run)
        return max(0.0, run.parameters.duration_s - to_seconds(self.env.clock.now_ns() - run.there_ns))

    def do(self, task: Task, follow: Follow) -> Script:
        """Keep near. Result: `near_share` of the time, within twice the distance."""
        self._point = self._point or task.place
        begun_ns = last_ns = received_ns = self.env.clock.now_ns()
        until_ns, near_ns = begun_ns + to_ns(follow.duration_s), 0
        bound_for: Point2D | None = None
        try:
            while last_ns < until_ns:
                yield
                now_ns = self.env.clock.now_ns()
                target = self._target(follow)
                if target is None and to_seconds(now_ns - received_ns) > LOST_TARGET_S:
                    raise Failed(f"{follow.robot} was not heard for {LOST_TARGET_S:g} s")
                if target is not None:
                    received_ns = now_ns
                    near_ns += (now_ns - last_ns) * (self.away_m(target) <= 2.0 * follow.distance_m)
                    if bound_for is None or target.distance_m(bound_for) > TARGET_MOVED_M:
                        goal = self._goal(target, follow.distance_m)
                        if goal is not None and self.travel.set_out(goal, priority=task.priority):
                            bound_for = target
                if self.travel.step() in TROUBLE:
                    self.travel.stop()
                    bound_for = None
                last_ns = now_ns
        finally:
            self._point = None
        self.travel.stop()
        return {"near_share": round(near_ns / (last_ns - begun_ns), 3)}

    def _target(self, follow: Follow) -> Point2D | None:
        if not follow.robot:
            return self._point
        teammate = next((one for one in self._teammates.others() if one.name == follow.robot), None)
        return None if teammate is None else Point2D(teammate.pose.x_m, teammate.pose.y_m)

    def _goal(self, target: Point2D, distance_m: float) -> Point2D | None:
        """Where a path to the target is this far from its end; None if the robot is nearer, or there is no path."""
        path = self.travel.plan(target)
        if not path:
            return None
        back = [*reversed(path[:-1]), self.travel.place()]
        return point_along(path[-1], back, distance_m - path[-1].distance_m(target))
