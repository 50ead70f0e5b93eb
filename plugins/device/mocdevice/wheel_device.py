"""A base on wheels: velocities down as wheel commands, wheel counts up as odometry, whatever the bus and the wheels.

What goes wrong on the bus is a fault of this device: a controller that falls silent, a bus that is off or cannot be
read, a power stage that has failed. The fault is reported to the team, plugins that require the device are set aside,
and the manifest's restart policy opens the bus again until it answers. The odometry continues where it was.
"""

import logging
from collections.abc import Sequence, Sized
from typing import NamedTuple

import msgspec

from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.agent.silence import FirstWord, Silence
from robrain.algorithms.localization.odometry import GyroYaw
from robrain.algorithms.navigation.wheel_bases import OmniBase, WheelBase
from robrain.plugins.device.mocdevice.errors import BusFault, MotionFault, MotorFault
from robrain.plugins.device.mocdevice.frame_clock import FrameClock, StampedAt
from robrain.plugins.device.mocdevice.interface import (
    ControllerStatus,
    Counters,
    DriveCondition,
    WheelCounts,
    WheelsInterface,
)
from robrain.plugins.device.mocdevice.odometry import Counting, Ticks, WheelOdometry
from robrain.plugins.device.mocdevice.wheel_link import WheelLink, WheelReport
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.model.ranges import check_positive

logger = logging.getLogger(__name__)

ACKNOWLEDGE_NS = to_ns(0.1)
"""A status that left the controller before it heard an acknowledgement is not held against it."""


ABSURD = 1e6
"""No part of a velocity is greater, in m/s and rad/s; its square would be no number soon."""

FAST_PERIOD_S = 0.02
"""Period of the step for a lidar that needs the odometry while it turns."""


class OpenLink(NamedTuple):
    """A connection, and how its counts are to be read."""

    link: WheelLink
    where: str
    """What is missing if it is silent, such as `the CAN bus socketcan:can0 is cut or its controller gone`."""
    counting: Counting
    period_s: float
    """Of the reports."""
    stamped_at: StampedAt
    start_s: float = 0.0
    """A controller that starts when its line is opened may be silent for so long."""


class WheelDevice(Device):
    """Turns velocities into wheel commands and wheel counts into odometry; subclasses open the link."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """What all bases have in common."""

        radius_m: float = 0.20
        """Radius of the round footprint."""
        base: WheelBase = OmniBase()
        """`type` is omni3 (three wheels at 120°), omni, mecanum, differential or ackermann."""
        wheel_speed_max_rad_s: float = 32.0
        """Fastest command of a wheel."""
        silent_s: float = 0.4
        """Time without counts after which the controller counts as gone; those of the Robertino come every 20 ms."""

        def __post_init__(self) -> None:
            check_positive(self, "radius_m", "silent_s", "wheel_speed_max_rad_s", below=1000.0)

    interface = WheelsInterface
    period_s = 0.06  # and whenever somebody asks for the odometry
    parameters: Parameters
    condition = Event[DriveCondition](outside=True)

    def init(self) -> None:
        self._link: WheelLink | None = None
        self._pending: Sized = ()
        """Empty if there is nothing to catch up with."""
        self._believed = self._rejected = 0
        self._gyro, self._has_gyro, self._comparisons = GyroYaw(), False, 0

    def open_link(self) -> "OpenLink":
        """Open the connection to the controller (HardwareAbsent, or ValueError naming a wrong parameter)."""
        raise NotImplementedError

    def activate(self) -> None:
        board, wanted = self.env.board, self.parameters
        self._silent_ns = to_ns(wanted.silent_s)
        self._is_again = board.T_odom_robot is not None
        """The controller has spoken before: this is a restart, or a reload."""
        opened = self.open_link()
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
        self._received_ns: int | None = None
        self._since_ns, self._start_ns = self.env.clock.now_ns(), to_ns(opened.start_s)
        self._silence = Silence(self._silent_ns)
        self._first = FirstWord(self._since_ns)
        self._link = opened.link
        self._pending = opened.link.pending

    def step(self) -> None:
        if self._link is None:
            return
        try:
            self._catch_up()
            self._check(self._link)
            if self.env.board.wants_odometry:
                self.period_s = FAST_PERIOD_S
                self.env.board.odometry = self._odometry.recent(self._frame_clock.offset_ns)
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
            return  # it may hear and not be heard: no motion before it has spoken
        forward_m_s, left_m_s, yaw_rad_s = twist.forward_m_s, twist.left_m_s, twist.yaw_rad_s
        # Plain comparisons: this runs many times a second.
        if not (-ABSURD < forward_m_s < ABSURD and -ABSURD < left_m_s < ABSURD and -ABSURD < yaw_rad_s < ABSURD):
            raise ValueError(f"expected a finite velocity, got {twist}")
        wanted = self.parameters
        if self._link is not None:
            self._link.command(wanted.base.commands(twist, wanted.wheel_speed_max_rad_s))

    def drive_wheels(self, values: Sequence[float]) -> None:
        """Give the base's commands themselves: wheel speeds in rad/s, of Ackermann a speed and a steering angle."""
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
    def is_fresh(self) -> bool:
        """Whether the wheel encoders send data."""
        if self._pending:
            self._catch_up()
        return self._received_ns is not None and self.env.clock.now_ns() - self._received_ns <= self._silent_ns

    def pose(self) -> Pose2D:
        """T_odom_robot from the wheel encoders."""
        if self._pending:
            self._catch_up()
        return self._odometry.pose

    def pose_if_fresh(self) -> tuple[Pose2D, bool]:
        """`pose` and `is_fresh` in one call, for who asks many times a second."""
        if self._pending:
            self._catch_up()
        heard_ns = self._received_ns
        is_fresh = heard_ns is not None and self.env.clock.now_ns() - heard_ns <= self._silent_ns
        return self._odometry.pose, is_fresh

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """T_odom_robot at a time within the last five seconds, between the encoder frames before and after it."""
        if self._pending:
            self._catch_up()
        return self._odometry.pose_at(stamp_ns - self._frame_clock.offset_ns)

    def odometry_until_ns(self) -> int:
        """Time of measurement of the newest wheel counts; 0 before the first."""
        if self._pending:
            self._catch_up()
        until_ns = self._odometry.until_ns
        return until_ns + self._frame_clock.offset_ns if until_ns is not None else 0

    def velocity(self) -> Twist2D:
        """Velocity in the body frame, from the encoders."""
        if self._pending:
            self._catch_up()
        return self._odometry.velocity

    def radius_m(self) -> float:
        """Radius of the round footprint."""
        return self.parameters.radius_m

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
        """Take in what has arrived. The device's own step raises a fault of the bus, never a caller's call."""
        link = self._link
        if link is None:
            return
        for report in link.take():
            self._record(report)

    def _check(self, link: WheelLink) -> None:
        if link.broken is not None:
            raise link.broken
        if link.statuses != self._statuses:
            self._statuses = link.statuses
            if link.has_failed:
                self._record_failure(link)
        since_ns, now_ns = self._received_ns, self.env.clock.now_ns()
        if since_ns is None:
            if not self._is_again:  # it has never spoken: it may still be starting; the driver stands until it does
                if self._first.is_missing(now_ns):
                    logger.warning("%s: no encoder frame yet: %s", self.env.robot, link.refusal or self._where)
                return
            if 0 <= now_ns - self._since_ns < self._start_ns:
                return
            since_ns = self._since_ns
        if now_ns - since_ns <= self._silence.begins_ns:
            return
        silent_ns = self._silence.since(since_ns, now_ns)
        if silent_ns > self._silent_ns:
            silent_s = silent_ns / NS_PER_S
            raise BusFault(self.env.plugin, f"no encoder frame for {silent_s:.2f} s: {link.refusal or self._where}")

    def _record_failure(self, link: WheelLink) -> None:
        now_ns = self.env.clock.now_ns()
        if self._is_again and self._acknowledged_ns is None:
            self._acknowledged_ns = now_ns
            link.stop()
        elif self._acknowledged_ns is None or now_ns - self._acknowledged_ns > ACKNOWLEDGE_NS:
            raise MotorFault(self.env.plugin, "the motor controller reports that its power stage has failed")

    def _record(self, report: WheelReport) -> None:
        counter, now_ns = report.counter, self.env.clock.now_ns()
        measured_ns, missing = self._frame_clock.note(counter, report.stamp_ns, now_ns), report.missing
        if counter is None and self._received_ns is not None:  # by the time since the one before
            missing = max(0, round((measured_ns - self._measured_ns) / self._period_ns) - 1)
        self._measured_ns, before = measured_ns, self._odometry.ticks
        if self._odometry.take(report.counts, measured_ns, missing):
            self._believed += 1
        else:
            self._rejected += 1
            self._frame_clock.restart_stamp()
        if self._received_ns is None and self._is_again:
            self.condition.notify(DriveCondition(True, "the motor controller speaks again"))
        self._received_ns = now_ns
        board = self.env.board
        if board.yaw_rates or self._has_gyro:
            self._correct_yaw(report.counts, before, measured_ns + self._frame_clock.offset_ns)
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
