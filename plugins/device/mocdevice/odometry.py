"""Dead reckoning from the counts of the wheels, with the last five seconds of it kept."""

import itertools
from typing import NamedTuple

from robrain.algorithms.localization.odometry import PoseTrack, moved
from robrain.algorithms.navigation.wheel_bases import WheelBase
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad

ENCODER_MODULUS = 1 << 16
ENCODER_PERIOD_S = 0.02
HISTORY_FRAMES = 256
"""Number of frames kept, five seconds: scans and frames may wait while the computer is busy."""
RECENT_FRAMES = 32
JUMP_SLACK = 2.0
"""Wheels that seem to have turned this many times as far as they can have not: the counter has."""

STANDING = Twist2D()

Ticks = tuple[int, ...]


class Counting(NamedTuple):
    """What the counts of wheels mean."""

    modulus: int
    """At which they wrap."""
    rad_per_tick: float


class WheelOdometry(PoseTrack):
    """Adds up encoder counts to T_odom_robot.

    Args:
        base: what the robot takes its base for.
        wheel_speed_max_rad_s: what the wheels can do.
        pose: where the odometry goes on from.
        ticks: counts at that pose, if they are known; else the first counts are taken as standing there.
        counting: what the counts mean; 16 bits of the base's encoders if None.
        period_s: of the frames.

    """

    def __init__(
        self,
        base: WheelBase,
        wheel_speed_max_rad_s: float,
        pose: Pose2D,
        ticks: Ticks | None,
        *,
        counting: Counting | None = None,
        period_s: float = ENCODER_PERIOD_S,
    ) -> None:
        super().__init__(pose, HISTORY_FRAMES)
        self.ticks = ticks
        self.velocity = STANDING
        self.turned_rad = 0.0
        """By the wheels alone, in the last frame."""
        self.jumps = 0
        """How often the counts have jumped, as after a restart of the controller; the pose stays as it was then."""
        self._base = base
        self._modulus, self._rad_per_tick = counting or Counting(ENCODER_MODULUS, base.rad_per_tick)
        self._half = self._modulus // 2
        self._period_s = period_s
        self._stamp_ns: int | None = None
        self._ticks_per_frame = JUMP_SLACK * wheel_speed_max_rad_s * period_s / self._rad_per_tick

    def take(self, ticks: Ticks, stamp_ns: int, missing: int) -> bool:
        """Take the counts of one frame; returns False if they have jumped.

        `stamp_ns` is the time of measurement, `missing` the number of frames lost before this one. Earlier frames with
        a later stamp, as after a clock was set back, are forgotten.
        """
        before, self.ticks = self.ticks, ticks
        since_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        has_jumped = False
        self.velocity, self.turned_rad = STANDING, 0.0
        if before is not None and ticks != before:
            half, modulus = self._half, self._modulus
            # The shortest way round the counter.
            steps, turns, share = [], [], self._rad_per_tick  # plain loops: this runs for each frame
            for now, then in zip(ticks, before, strict=True):
                step = (now - then + half) % modulus - half
                steps.append(step)
                turns.append(step * share)
            # After a silence nobody knows how many frames are missing; the watchdog stops the wheels within a second.
            frames = missing + 1 if since_ns is not None else 1.0 / self._period_s
            most = max(map(abs, steps))
            if most > frames * self._ticks_per_frame or (since_ns is None and self._begins_at_0(ticks, most)):
                self.jumps += 1
                has_jumped = True
            else:
                displacement = self._base.twist(*turns)
                self.pose = moved(self.pose, displacement)
                self.turned_rad = displacement.yaw_rad_s
                if since_ns is not None:  # by the controller's time, as frames may arrive in bursts
                    elapsed_s = frames * self._period_s
                    self.velocity = Twist2D(
                        displacement.forward_m_s / elapsed_s,
                        displacement.left_m_s / elapsed_s,
                        displacement.yaw_rad_s / elapsed_s,
                    )
        while self._history and self._history[-1][0] >= stamp_ns:
            self._history.pop()
        self._history.append((stamp_ns, self.pose))
        return not has_jumped

    def _begins_at_0(self, ticks: Ticks, most: int) -> bool:
        """Whether counts are nearer to 0 than to those before this start: the controller has started again as well."""
        return max(min(count, self._modulus - count) for count in ticks) < most

    def recent(self, offset_ns: int) -> tuple[tuple[int, Pose2D], ...]:
        """The last `RECENT_FRAMES` times, plus the offset, and poses; the oldest first."""
        history = self._history
        first = max(0, len(history) - RECENT_FRAMES)
        return tuple([(stamp_ns + offset_ns, pose) for stamp_ns, pose in itertools.islice(history, first, None)])

    def turn(self, angle_rad: float, rate_rad_s: float | None) -> None:
        """Turn the pose of the last frame by what a gyroscope has measured beyond the wheels' turning.

        `rate_rad_s` takes the place of the wheels' turn rate in the velocity; None leaves it.
        """
        pose = self.pose
        self.pose = Pose2D(pose.x_m, pose.y_m, wrap_angle_rad(pose.yaw_rad + angle_rad))
        if self._history:
            self._history[-1] = (self._history[-1][0], self.pose)
        if rate_rad_s is not None:
            velocity = self.velocity
            self.velocity = Twist2D(velocity.forward_m_s, velocity.left_m_s, rate_rad_s)
