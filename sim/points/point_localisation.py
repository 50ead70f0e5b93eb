"""Localisation of a point: the true pose."""

from robrain.agent.event import Event
from robrain.agent.plugin import Skill, external
from robrain.plugins.skill.localisation import Divergence, Localisation, LocalisationHealth, LocalisationInterface
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D
from robrain.sim.points.point_team import POINT_TICK_S, robot_of

VARIANCE = 1e-6
"""Of x, y (m²) and yaw (rad²)."""
COVARIANCE = (VARIANCE, 0.0, 0.0, 0.0, VARIANCE, 0.0, 0.0, 0.0, VARIANCE)


class PointLocalisation(Skill):
    """Localisation with the true pose of the robot."""

    Parameters = Localisation.Parameters
    interface = LocalisationInterface
    period_s = POINT_TICK_S
    diverged = Event[Divergence](outside=True)

    def activate(self) -> None:
        self._robot = robot_of(self.env)
        board = self.env.board
        board.T_arena_odom, board.pose_covariance, board.radius_m = IDENTITY, COVARIANCE, self._robot.radius_m
        self.step()

    def step(self) -> None:
        board, robot = self.env.board, self._robot
        board.pose, board.velocity = robot.pose, robot.velocity

    @external
    def pose(self) -> Pose2D:
        """T_arena_robot now."""
        return self._robot.pose

    def to_odom(self, points: list[Point2D]) -> list[Point2D]:
        """The same points: both frames are one."""
        return points

    @external
    def health(self) -> LocalisationHealth:
        """Quality of the estimate."""
        return LocalisationHealth(
            lost="",
            sigma_m=VARIANCE**0.5,
            sigma_rad=VARIANCE**0.5,
            mean_nis=0.0,
            signals=0,
            signals_refused=0,
            matches=0,
            last_fit=1.0,
            scale_error=0.0,
            curve_rad_per_m=0.0,
            turn_error=0.0,
        )
