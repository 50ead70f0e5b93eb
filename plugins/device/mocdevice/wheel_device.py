"""A base on wheels: velocities down as wheel commands, wheel counts up as odometry, for any bus and wheels.

A bus error is a fault of this device: a silent controller, a bus that is off or unreadable, a failed power stage. The
fault is reported to the team, and plugins that require the device are set aside. The manifest's restart policy opens
the bus again until the controller answers. The odometry continues where it was.
"""

import itertools
import logging
from collections.abc import Sequence, Sized
from typing import Annotated, NamedTuple, Protocol

import msgspec
from msgspec import Meta

from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.agent.silence import FirstWord, Silence
from robrain.algorithms.localization.odometry import GyroYaw, PoseTrack, moved
from robrain.algorithms.navigation.wheel_bases import OmniBase, WheelBase
from robrain.plugins.device.mocdevice.frame_clock import FrameClock, StampedAt
from robrain.plugins.device.mocdevice.interface import (
    BusFault,
    ControllerStatus,
    Counters,
    DriveCondition,
    MotionFault,
    MotorFault,
    WheelCounts,
    WheelsInterface,
)
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad

logger = logging.getLogger(__name__)


class WheelReport(msgspec.Struct, frozen=True):
    """Counts of all wheels at one time."""

    counts: tuple[int, ...]
    """One for each wheel; they wrap."""
    stamp_ns: int
    """Time stamp of the interface."""
    counter: int | None = None
    """The frame's 8-bit counter; None if it has none."""
    missing: int = 0
    """Reports lost before this one, by the counter."""


class WheelLink(Protocol):
    """A connection to a motor controller; its users' calls never fail, as the device's own step raises `broken`."""

    pending: Sized = (None,)
    """Empty if `receive` has nothing to return."""
    status: ControllerStatus | None = None
    """Last status of the controller; None before the first, or if it sends none."""
    statuses: int = 0
    """Number of statuses received."""
    has_failed: bool = False
    """Whether the last status reports a failed power stage."""
    broken: MotionFault | None = None
    """Error by which nothing can be sent or read any more; None if there is none."""

    @property
    def refusal(self) -> str:
        """Messages since the last report that are no report, with the reason; empty if there are none."""

    def command(self, values: Sequence[float]) -> None:
        """Send the base's commands."""

    def stop(self) -> None:
        """Stop the wheels at once."""

    def receive(self) -> list[WheelReport]:
        """Reports that have arrived since the last call."""

    def counters(self, believed: int, rejected: int) -> Counters:
        """Counters of the bus; the device adds the numbers of believed and rejected reports."""

    def close(self) -> None:
        """Leave the bus."""


HISTORY_FRAMES = 256
"""Number of frames kept, five seconds: scans and frames may wait while the computer is busy."""
RECENT_FRAMES = 32
JUMP_SLACK = 2.0
"""A base that seems to have moved this many times as far as it can has not: its counts or odometry have jumped."""

STILL = Twist2D()

Ticks = tuple[int, ...]


class Counting(NamedTuple):
    """Meaning of the wheels' counts."""

    modulus: int
    """Count at which they wrap."""
    rad_per_tick: float


class BaseOdometry(PoseTrack):
    """Pose and velocity of a base by its own measurements: T_odom_robot."""

    velocity = STILL

    def _record(self, stamp_ns: int) -> None:
        """Keep the pose as that of this time; later ones, as after a clock was set back, are forgotten."""
        while self._history and self._history[-1][0] >= stamp_ns:
            self._history.pop()
        self._history.append((stamp_ns, self.pose))


class WheelOdometry(BaseOdometry):
    """Adds up encoder counts to T_odom_robot.

    Args:
        base: the robot's assumed base.
        wheel_speed_max_rad_s: limits of the wheels.
        pose: pose from which the odometry continues.
        ticks: counts at that pose, if they are known; otherwise the first counts belong to it.
        counting: meaning of the counts.
        period_s: of the frames.

    """

    def __init__(
        self,
        base: WheelBase,
        wheel_speed_max_rad_s: float,
        pose: Pose2D,
        ticks: Ticks | None,
        *,
        counting: Counting,
        period_s: float,
    ) -> None:
        super().__init__(pose, HISTORY_FRAMES)
        self.ticks = ticks
        self.turned_rad = 0.0
        """Turn by the wheels alone, in the last frame."""
        self._base = base
        self._modulus, self._rad_per_tick = counting
        self._half = self._modulus // 2
        self._period_s = period_s
        self._stamp_ns: int | None = None
        self._ticks_per_frame = JUMP_SLACK * wheel_speed_max_rad_s * period_s / self._rad_per_tick

    def follow(self, ticks: Ticks, stamp_ns: int, missing: int) -> bool:
        """Take the counts of one frame; returns False if they have jumped, as after a restart of the controller.

        The pose stays as it was then. `stamp_ns` is the time of measurement, `missing` the number of frames lost before
        this one.
        """
        before, self.ticks = self.ticks, ticks
        since_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        has_jumped = False
        self.velocity, self.turned_rad = STILL, 0.0
        if before is not None and ticks != before:
            half, modulus = self._half, self._modulus
            # The shortest difference on the wrapping counter.
            steps, turns, share = [], [], self._rad_per_tick  # plain loops: this runs for each frame
            for now, then in zip(ticks, before, strict=True):
                step = (now - then + half) % modulus - half
                steps.append(step)
                turns.append(step * share)
            # After a silence the number of missing frames is unknown; the watchdog stops the wheels within a second.
            frames = missing + 1 if since_ns is not None else 1.0 / self._period_s
            most = max(map(abs, steps))
            if most > frames * self._ticks_per_frame or (since_ns is None and self._begins_at_0(ticks, most)):
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
        self._record(stamp_ns)
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
        """Turn the pose of the last frame by a gyroscope's turn beyond that of the wheels.

        `rate_rad_s` takes the place of the wheels' turn rate in the velocity; None leaves it.
        """
        pose = self.pose
        self.pose = Pose2D(pose.x_m, pose.y_m, wrap_angle_rad(pose.yaw_rad + angle_rad))
        if self._history:
            self._history[-1] = (self._history[-1][0], self.pose)
        if rate_rad_s is not None:
            velocity = self.velocity
            self.velocity = Twist2D(velocity.forward_m_s, velocity.left_m_s, rate_rad_s)


ACKNOWLEDGE_NS = to_ns(0.1)
"""A status that left the controller before it received an acknowledgement does not count against it."""


ABSURD = 1e6
"""Largest part of a velocity, in m/s and rad/s; the square of a much larger one would overflow."""

FAST_PERIOD_S = 0.02
"""Period of the step for a lidar that needs the odometry while it turns."""


class OpenLink(NamedTuple):
    """A connection, and the meaning of its counts."""

    link: WheelLink
    where: str
    """Description of the fault of a silent bus, such as `the CAN bus socketcan:can0 is cut or its controller gone`."""
    counting: Counting
    period_s: float
    """Of the reports."""
    stamped_at: StampedAt
    start_s: float = 0.0
    """Longest silence of a controller that starts when its line is opened."""


class BaseDevice(Device):
    """Common part of all bases: their odometry, and silence as a fault."""

    period_s = 0.06  # and at each request of the odometry
    condition = Event[DriveCondition](outside=True)
    reports = "encoder frame"
    """Name of one report of the base, for faults."""
    _odometry: BaseOdometry
    _pending: object = ()
    """True if reports wait."""
    _offset_ns = 0
    """The robot's time less that of the odometry."""
    _received_ns: int | None = None

    def begin(self, silent_s: float, start_s: float = 0.0) -> None:
        """Count the silence from now on; a controller that starts when its line is opened may be silent for longer."""
        self._is_again = self.env.board.T_odom_robot is not None
        """The base has reported before: this is a restart, or a reload."""
        self._received_ns = None
        self._silent_ns, self._start_ns = to_ns(silent_s), to_ns(start_s)
        self._since_ns = self.env.clock.now_ns()
        self._silence, self._first = Silence(self._silent_ns), FirstWord(self._since_ns)

    def silence_reason(self) -> str:
        """Reason why no report is accepted."""
        raise NotImplementedError

    def _catch_up(self) -> None:
        """Read the arrived reports; the device's own step raises a fault of the bus, never a caller's call."""
        raise NotImplementedError

    @external
    def is_fresh(self) -> bool:
        """Whether the base reports its odometry."""
        return self.pose_if_fresh()[1]

    def pose(self) -> Pose2D:
        """T_odom_robot by the odometry."""
        if self._pending:
            self._catch_up()
        return self._odometry.pose

    def pose_if_fresh(self) -> tuple[Pose2D, bool]:
        """`pose` and `is_fresh` in one call, for users that poll many times a second."""
        if self._pending:
            self._catch_up()
        received_ns = self._received_ns
        is_fresh = received_ns is not None and self.env.clock.now_ns() - received_ns <= self._silent_ns
        return self._odometry.pose, is_fresh

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """T_odom_robot at a time within the last five seconds, between the reports before and after it."""
        if self._pending:
            self._catch_up()
        return self._odometry.pose_at(stamp_ns - self._offset_ns)

    def odometry_until_ns(self) -> int:
        """Time of measurement of the newest odometry; 0 before the first."""
        if self._pending:
            self._catch_up()
        until_ns = self._odometry.until_ns
        return until_ns + self._offset_ns if until_ns is not None else 0

    def velocity(self) -> Twist2D:
        """Velocity in the body frame."""
        if self._pending:
            self._catch_up()
        return self._odometry.velocity

    def radius_m(self) -> float:
        """Radius of the round footprint."""
        radius_m: float = self.parameters.radius_m
        return radius_m

    def _check_silence(self) -> None:
        since_ns, now_ns = self._received_ns, self.env.clock.now_ns()
        if since_ns is None:
            if not self._is_again:  # no message yet: it may still be starting; the driver waits for it
                if self._first.is_missing(now_ns):
                    logger.warning("%s: no %s yet: %s", self.env.robot, self.reports, self.silence_reason())
                return
            if 0 <= now_ns - self._since_ns < self._start_ns:
                return
            since_ns = self._since_ns
        if now_ns - since_ns <= self._silence.begins_ns:
            return
        silent_ns = self._silence.since(since_ns, now_ns)
        if silent_ns > self._silent_ns:
            what = f"no {self.reports} for {silent_ns / NS_PER_S:.2f} s"
            raise BusFault(self.env.plugin, f"{what}: {self.silence_reason()}")


class WheelDevice(BaseDevice):
    """Turns velocities into wheel commands and wheel counts into odometry; subclasses open the link."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """Common parameters of all wheeled bases."""

        radius_m: Annotated[float, Meta(gt=0, lt=1000.0)] = 0.20
        """Radius of the round footprint."""
        base: WheelBase = OmniBase()
        """`type` is omni3 (three wheels at 120°), omni, mecanum, differential or ackermann."""
        wheel_speed_max_rad_s: Annotated[float, Meta(gt=0, lt=1000.0)] = 32.0
        """Fastest command of a wheel."""
        silent_s: Annotated[float, Meta(gt=0, lt=1000.0)] = 0.4
        """Time without counts after which the controller counts as gone; those of the Robertino come every 20 ms."""

    interface = WheelsInterface
    parameters: Parameters
    _odometry: WheelOdometry

    def init(self) -> None:
        self._link: WheelLink | None = None
        self._believed = self._rejected = 0

    def open_link(self) -> "OpenLink":
        """Open the connection to the controller (HardwareAbsent, or ValueError naming a wrong parameter)."""
        raise NotImplementedError

    def activate(self) -> None:
        board, wanted = self.env.board, self.parameters
        opened = self.open_link()
        self.begin(wanted.silent_s, opened.start_s)
        self._counting = opened.counting
        self._where, self._period_ns = opened.where, to_ns(opened.period_s)
        ticks = board.wheel_ticks
        if ticks is not None and len(ticks) != wanted.base.wheels:
            ticks = None
        self._odometry = WheelOdometry(
            wanted.base,
            wanted.wheel_speed_max_rad_s,
            board.T_odom_robot or Pose2D(0.0, 0.0, 0.0),
            ticks,
            counting=opened.counting,
            period_s=opened.period_s,
        )
        self._gyro, self._has_gyro, self._comparisons = GyroYaw(), False, 0
        self._frame_clock = FrameClock(opened.stamped_at, self._period_ns)
        self._acknowledged_ns: int | None = None
        self._statuses = self._measured_ns = 0
        self._link = opened.link
        self._pending = opened.link.pending

    def step(self) -> None:
        link = self._link
        if link is None:
            return
        try:
            self._catch_up()
            if link.broken is not None:
                raise link.broken
            if link.statuses != self._statuses:
                self._statuses = link.statuses
                if link.has_failed:
                    self._record_failure(link)
            self._check_silence()
            if self.env.board.wants_odometry:
                self.period_s = FAST_PERIOD_S
                self.env.board.odometry = self._odometry.recent(self._offset_ns)
        except MotionFault as fault:
            self.condition.notify(DriveCondition(False, str(fault)))
            raise

    def deactivate(self) -> None:
        link, self._link, self._pending = self._link, None, ()
        if link is None:
            return
        try:
            link.stop()
        finally:
            link.close()

    def emergency_halt(self) -> None:
        self.stop()

    def drive(self, twist: Twist2D) -> None:
        """Command a velocity, body frame. It holds for 200 ms; beyond the wheels' limit its direction is kept."""
        if self._is_again and self._received_ns is None:
            return  # it may receive but not send: no motion before its first message
        forward_m_s, left_m_s, yaw_rad_s = twist.forward_m_s, twist.left_m_s, twist.yaw_rad_s
        # Plain comparisons: this runs many times a second.
        if not (-ABSURD < forward_m_s < ABSURD and -ABSURD < left_m_s < ABSURD and -ABSURD < yaw_rad_s < ABSURD):
            raise ValueError(f"expected a finite velocity, got {twist}")
        wanted = self.parameters
        if self._link is not None:
            self._link.command(wanted.base.commands(twist, wanted.wheel_speed_max_rad_s))

    def drive_wheels(self, values: Sequence[float]) -> None:
        """Send the base's commands directly: wheel speeds in rad/s, of Ackermann a speed and a steering angle."""
        limit, known = self.parameters.wheel_speed_max_rad_s, len(self.parameters.base.commands(Twist2D(), 1.0))
        if len(values) != known or not all(abs(value) <= limit for value in values):
            raise ValueError(f"expected {known} commands within ±{limit:g}, got {list(values)}")
        if self._link is not None:
            self._link.command(values)

    def wheel_counts(self) -> WheelCounts | None:
        """The last counts; None before the first."""
        if self._pending:
            self._catch_up()
        counts = self._odometry.ticks
        return None if counts is None else WheelCounts(counts, *self._counting)

    @external
    def stop(self) -> None:
        """Stop the wheels at once."""
        if self._link is not None:
            self._link.stop()

    @external
    def is_holonomic(self) -> bool:
        """Whether the base can drive sideways."""
        return self.parameters.base.is_holonomic

    @external
    def turn_radius_min_m(self) -> float:
        """Radius of the tightest turn; 0 for a base that turns on the spot."""
        return self.parameters.base.turn_radius_min_m

    @external
    def counters(self) -> Counters:
        """Frames believed, rejected, foreign and lost, and error frames."""
        if self._pending:
            self._catch_up()
        if self._link is None:
            return Counters(self._believed, self._rejected, 0, 0, 0)
        return self._link.counters(self._believed, self._rejected)

    @external
    def status(self) -> ControllerStatus | None:
        """Last status of the motor controller; null before the first."""
        if self._pending:
            self._catch_up()
        return self._link.status if self._link is not None else None

    @external
    def gyro_bias_rad_s(self) -> float | None:
        """Bias of the gyroscope that the yaw comes from; null while the yaw is the wheels'."""
        return self._gyro.bias_rad_s if self._gyro.is_used else None

    def _catch_up(self) -> None:
        if self._link is not None:
            for report in self._link.receive():
                self._record(report)

    def silence_reason(self) -> str:
        """The messages that are no report, or that nothing arrives."""
        return (self._link.refusal if self._link is not None else "") or self._where

    def _record_failure(self, link: WheelLink) -> None:
        now_ns = self.env.clock.now_ns()
        if self._is_again and self._acknowledged_ns is None:
            self._acknowledged_ns = now_ns
            link.stop()
        elif self._acknowledged_ns is None or now_ns - self._acknowledged_ns > ACKNOWLEDGE_NS:
            raise MotorFault(self.env.plugin, "the motor controller reports that its power stage has failed")

    def _record(self, report: WheelReport) -> None:
        counter, now_ns = report.counter, self.env.clock.now_ns()
        measured_ns, missing = self._frame_clock.add(counter, report.stamp_ns, now_ns), report.missing
        if counter is None and self._received_ns is not None:  # by the time since the one before
            missing = max(0, round((measured_ns - self._measured_ns) / self._period_ns) - 1)
        self._measured_ns, before = measured_ns, self._odometry.ticks
        if self._odometry.follow(report.counts, measured_ns, missing):
            self._believed += 1
        else:
            self._rejected += 1
            self._frame_clock.restart_stamp()
        self._offset_ns = self._frame_clock.offset_ns
        if self._received_ns is None and self._is_again:
            self.condition.notify(DriveCondition(True, "the motor controller speaks again"))
        self._received_ns = now_ns
        board = self.env.board
        if board.yaw_rates or self._has_gyro:
            self._correct_yaw(report.counts, before, measured_ns + self._offset_ns)
        board.T_odom_robot, board.wheel_ticks = self._odometry.pose, report.counts

    def _correct_yaw(self, counts: Ticks, before: Ticks | None, stamp_ns: int) -> None:
        gyro, odometry = self._gyro, self._odometry
        # Between two marks of an encoder a standing wheel goes to and fro by one count.
        is_moving = before is None or any(abs(now - then) > 1 for now, then in zip(counts, before, strict=True))
        beyond_rad = gyro.follow(self.env.board.yaw_rates, odometry.turned_rad, stamp_ns, is_moving=is_moving)
        odometry.turn(beyond_rad, gyro.rate_rad_s)
        if gyro.comparisons != self._comparisons:
            self._comparisons = gyro.comparisons
            contradicts = not gyro.is_trusted and not gyro.agrees
            self.env.board.gyro_contradiction = gyro.ratio if contradicts else None
        self._has_gyro = gyro.is_used
