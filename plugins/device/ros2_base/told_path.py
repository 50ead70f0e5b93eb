"""T_odom_robot from the odometry that a base reports: without its jumps, and with the last seconds of it kept."""

from robrain.plugins.device.ros2_base.odometry_message import ToldOdometry
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.model.localization.pose_track import PoseTrack
from robrain.protocol.wire.clock import NS_PER_S, to_seconds

HISTORY_NS = 5 * NS_PER_S
HISTORY_MESSAGES = 2048
JUMP_SLACK = 2.0
"""A base that seems to have moved this many times as fast as it can has not: its odometry has jumped."""
JUMP_M, JUMP_RAD = 0.05, 0.1
"""Less than this is no jump."""
BLIND_S = 1.0
"""How long a base may have moved while nothing was heard of it: its watchdog stops it."""
STANDING = Twist2D()


class ToldPath(PoseTrack):
    """Follows the odometry of a base; the frame odom begins where the robot was first heard.

    Args:
        speed_m_s: greatest speed of the base.
        turn_rate_rad_s: its greatest turn rate.
        pose: T_odom_robot from which it goes on.
        before: what the base reported at that pose, and the number of that message; None if that is not known.

    """

    def __init__(
        self, speed_m_s: float, turn_rate_rad_s: float, pose: Pose2D, before: tuple[Pose2D, int] | None
    ) -> None:
        super().__init__(pose, HISTORY_MESSAGES)
        self.velocity = STANDING
        self.before = before
        self._speed_m_s, self._turn_rate_rad_s = speed_m_s, turn_rate_rad_s

    def take(self, told: ToldOdometry, measured_ns: int, number: int) -> bool:
        """Take what the base reports; returns False if its odometry has jumped, and the pose has stayed.

        Args:
            told: the message.
            measured_ns: its time of measurement, robot's clock.
            number: its publisher's count of messages. A publisher that counts from the start again has been started
                again, and so may have been its odometry; 0 if there is no count.

        """
        before, self.before = self.before, (told.pose, number)
        has_jumped = False
        if before is not None:
            displacement = before[0].inverse().compose(told.pose)
            if 0 < number <= before[1] or self._is_jump(displacement, measured_ns):
                has_jumped = True
            else:
                self.pose = self.pose.compose(displacement)
        self.velocity = STANDING if has_jumped else told.velocity
        history = self._history
        while history and history[-1][0] >= measured_ns:  # a clock was set back
            history.pop()
        history.append((measured_ns, self.pose))
        while history[0][0] < measured_ns - HISTORY_NS:
            history.popleft()
        return not has_jumped

    def _is_jump(self, displacement: Pose2D, measured_ns: int) -> bool:
        until_ns = self.until_ns
        passed_s = BLIND_S if until_ns is None else max(to_seconds(measured_ns - until_ns), 0.0)
        reach_m = JUMP_M + JUMP_SLACK * self._speed_m_s * passed_s
        reach_rad = JUMP_RAD + JUMP_SLACK * self._turn_rate_rad_s * passed_s
        return displacement.distance_m(Pose2D(0.0, 0.0, 0.0)) > reach_m or abs(displacement.yaw_rad) > reach_rad
