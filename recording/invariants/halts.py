"""Halts are obeyed: a halted robot stands, and a robot in contact with a halted team is halted.

While a robot is halted its own pose does not change. Without ground truth, the pose at the halt is therefore compared
with the first pose after it.
"""

from collections.abc import Mapping

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.arena_messages import ArenaTruth, RobotTruth
from robrain.protocol.messages.team.team_messages import Halt, TeamState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.tasks.halt_latch import HaltLatch
from robrain.recording.invariants.findings import HaltIgnored, Invariant, MissingEvidence, MovedHalted
from robrain.recording.invariants.invariant_judge import Handler, InvariantJudge, Surroundings

STOPPED_NS = to_ns(1.0)
"""A halted robot stands after this: the firmware's watchdog, and braking from top speed (chosen: twice that)."""
MOVED_M = 0.05
"""A robot that stands is moved no farther than this, by the ground truth (chosen)."""
OWN_MOVED_M = 0.5
"""The same by its own pose: its path to a stop, and corrections of the pose (chosen), besides three deviations."""
HEEDED_NS = to_ns(2.0)
"""A robot in contact receives a halt within this, from the coordinator's summary at the latest (chosen)."""
SILENT_NS = to_ns(1.0)
"""Older messages of a robot do not count."""
GOES_ON_NS = to_ns(0.25)
"""After this time a resumed robot has published its own pose again."""
CARRIED_M_S = 3.0
"""No robot drives that fast: it was carried."""
CARRIED_M_S2 = 4.0
"""A standing robot that accelerates faster was carried a short distance (a base accelerates at 0.8 m/s²)."""
STANDING_M = 0.01
SHORT_NS = to_ns(0.1)
"""Accelerations are not computed over shorter intervals."""


class _Robot:
    """A robot, as far as halts matter."""

    def __init__(self) -> None:
        self.heard_ns = 0
        self.halted_ns: int | None = None
        """Time since which it reports to be halted."""
        self.resumed_ns: int | None = None
        self.is_reported = False
        self.own: tuple[Point2D, float] | None = None
        """Its own place when it was halted, and the deviation."""
        self.obeys = False
        """Whether it was halted since the team is."""
        self.in_contact_ns: int | None = None
        """Time since which the team has been halted and the coordinator receives it."""
        self.anchor: RobotTruth | None = None
        self.last: tuple[RobotTruth, int] | None = None
        self.was_standing = False
        """Whether it stood between the last two checks."""


class Halts(InvariantJudge):
    """Follows the team's halt and each robot's."""

    invariant = Invariant.HALTS

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._robots: dict[str, _Robot] = {}
        self._latch = HaltLatch()
        self._has_truth = False
        self._summary_ns: int | None = None

    def handlers(self) -> Mapping[type, Handler]:
        """Handlers by type of message."""
        return {
            Halt: self._handle_halt,
            TeamState: self._handle_summary,
            RobotState: self._handle_state,
            ArenaTruth: self._handle_truth,
        }

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        return None if self._robots else MissingEvidence.ROBOTS

    def _handle_halt(self, halt: Halt, time_ns: int) -> None:
        was_held = self._latch.is_held
        if halt.halted:
            self._latch.hold(halt.by, halt.reason, halt.stamp_ns)
        else:
            self._latch.release(halt.by, halt.stamp_ns)
        if self._latch.is_held != was_held:
            self.cases += self._latch.is_held
            self._restart()
        if self._summary_ns is None and self._latch.is_held:
            for robot in self._robots.values():
                robot.in_contact_ns = robot.in_contact_ns or time_ns

    def _handle_summary(self, summary: TeamState, time_ns: int) -> None:
        was_away = self._summary_ns is not None and time_ns - self._summary_ns > SILENT_NS
        self._summary_ns = time_ns
        if was_away:  # until now it could not reach the robots
            self._restart()
        status = summary.halt
        if status is None or not status.halted:
            self._restart()
            return
        for reported in summary.robots:
            robot = self._robots.get(reported.name)
            if robot is None:
                continue
            if not reported.up:
                robot.in_contact_ns = None
            elif robot.in_contact_ns is None:
                robot.in_contact_ns = time_ns
            self._judge_heeding(reported.name, robot, ", ".join(status.by), time_ns)

    def _restart(self) -> None:
        for robot in self._robots.values():
            robot.in_contact_ns = None
            robot.obeys = robot.halted_ns is not None

    def _judge_heeding(self, name: str, robot: _Robot, by: str, time_ns: int) -> None:
        since_ns = robot.in_contact_ns
        if since_ns is None or robot.obeys or time_ns - robot.heard_ns > SILENT_NS:
            return
        if time_ns - since_ns > HEEDED_NS:
            robot.obeys = True  # reported once for each halt
            for_s = round(to_seconds(time_ns - since_ns), 3)
            self.break_(time_ns, HaltIgnored(robot=name, by=by, for_s=for_s))

    def _handle_state(self, state: RobotState, time_ns: int) -> None:
        robot = self._robots.setdefault(state.robot, _Robot())
        if self._summary_ns is None and time_ns - robot.heard_ns > SILENT_NS:
            robot.in_contact_ns = None  # it missed messages, and no coordinator repeats them
        robot.heard_ns = time_ns
        if state.halted:
            robot.obeys = True
            if robot.halted_ns is None:
                self._halted(robot, state, time_ns)
            if not self._has_truth and time_ns - (robot.halted_ns or time_ns) > STOPPED_NS:
                self._judge_own(robot, state, time_ns)
            return
        if robot.halted_ns is not None and robot.resumed_ns is None:
            robot.resumed_ns = time_ns
            robot.anchor = None
        if robot.resumed_ns is not None and time_ns - robot.resumed_ns >= GOES_ON_NS:
            if not self._has_truth:
                self._judge_own(robot, state, time_ns)
            robot.halted_ns = robot.resumed_ns = robot.own = None
        if self._summary_ns is None and self._latch.is_held:
            self._judge_heeding(state.robot, robot, ", ".join(self._latch.holders), time_ns)

    def _halted(self, robot: _Robot, state: RobotState, time_ns: int) -> None:
        if not self._latch.is_held:
            self.cases += 1
        robot.halted_ns, robot.resumed_ns, robot.anchor, robot.is_reported = time_ns, None, None, False
        robot.own = None if state.pose is None or state.lost or state.frame != ARENA else _own_place(state)

    def _judge_own(self, robot: _Robot, state: RobotState, time_ns: int) -> None:
        if robot.own is None or robot.halted_ns is None or robot.is_reported or state.pose is None:
            return
        if state.lost or state.frame != ARENA:
            robot.own = None
            return
        (place, deviation_m), (now, now_deviation_m) = robot.own, _own_place(state)
        moved_m = place.distance_m(now)
        if moved_m > OWN_MOVED_M + 3.0 * (deviation_m + now_deviation_m):
            self._moved(state.robot, robot, moved_m, time_ns, is_true=False)

    def _handle_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        self._has_truth = True
        for now in truth.robots:
            robot = self._robots.get(now.robot)
            if robot is None:
                continue
            last, robot.last = robot.last, (now, time_ns)
            stands_ns = robot.halted_ns
            if stands_ns is None or robot.resumed_ns is not None or time_ns - robot.heard_ns > SILENT_NS:
                robot.anchor = None
            elif time_ns - stands_ns > STOPPED_NS:
                self._judge_true(now, robot, last, time_ns)

    def _judge_true(self, now: RobotTruth, robot: _Robot, last: tuple[RobotTruth, int] | None, time_ns: int) -> None:
        anchor, was_standing = robot.anchor, robot.was_standing
        robot.was_standing = last is not None and now.pose.distance_m(last[0].pose) < STANDING_M
        is_carried = last is not None and _was_carried(now, *last, time_ns, was_standing=was_standing)
        if anchor is None or last is None or now.collisions > anchor.collisions or is_carried:
            robot.anchor = now  # a robot that is pushed or carried does not move by itself
            return
        moved_m = now.pose.distance_m(anchor.pose)
        if moved_m > MOVED_M and not robot.is_reported:
            self._moved(now.robot, robot, moved_m, time_ns, is_true=True)

    def _moved(self, name: str, robot: _Robot, moved_m: float, time_ns: int, *, is_true: bool) -> None:
        assert robot.halted_ns is not None
        robot.is_reported = True
        since_s = self.time_s(robot.halted_ns)
        self.break_(time_ns, MovedHalted(robot=name, moved_m=round(moved_m, 3), since_s=since_s, is_true=is_true))


def _own_place(state: RobotState) -> tuple[Point2D, float]:
    """Place and standard deviation of a state with a pose."""
    assert state.pose is not None
    covariance = state.pose_covariance
    variance_m2 = max(covariance[0] + covariance[4], 0.0) if covariance else 0.0
    return Point2D(state.pose.x_m, state.pose.y_m), variance_m2**0.5


def _was_carried(now: RobotTruth, last: RobotTruth, last_ns: int, time_ns: int, *, was_standing: bool) -> bool:
    path_m, duration_s = now.pose.distance_m(last.pose), max(to_seconds(time_ns - last_ns), 0.02)
    if path_m > CARRIED_M_S * duration_s:
        return True
    return was_standing and time_ns - last_ns >= SHORT_NS and 2.0 * path_m > CARRIED_M_S2 * duration_s**2
