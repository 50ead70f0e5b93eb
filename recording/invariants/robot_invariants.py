"""Invariants of robots: none is stranded or crosses a wall, halts are obeyed, energy balances, no two wait for long."""

import math

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.messages.team.arena_messages import ArenaTruth, RobotTruth
from robrain.protocol.messages.team.team_messages import Halt, TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.tasks.halt_latch import HaltLatch
from robrain.recording.invariants.invariant import Invariant, InvariantJudge, MissingEvidence, Surroundings

CARRIED_M_S = 3.0
"""No robot drives that fast: it was carried, and the motion in between is not judged."""
SILENT_NS = to_ns(1.0)
"""Older messages of a robot do not count."""

EMPTY_AFTER_S = 2.0
"""A battery that has delivered nothing for this long has cut off (chosen: ten periods of the battery manager)."""
EMPTY_SOC = 0.001
"""State of charge below which a robot reports that it is empty."""
CHARGES_NS = to_ns(5.0)
"""A robot that reported to be charged no longer ago is at a charger."""
SLACK_M = 0.1
"""Beyond a charger's reach that still counts as being there."""


class _RobotCharge:
    """A robot's battery, as far as an empty one matters."""

    def __init__(self) -> None:
        self.battery: BatteryState | None = None
        """Its last report."""
        self.charged_ns: int | None = None
        """Time of its last report that it is charged."""
        self.energy_j: float | None = None
        self.since_s = 0.0
        """Since when the truth has had the same `energy_j`."""
        self.empty_ns: int | None = None
        """Time since which it reports that it is empty."""
        self.is_reported = False


class NotStranded(InvariantJudge):
    """Detects robots whose batteries deliver nothing."""

    invariant = Invariant.NOT_STRANDED
    evidence = MissingEvidence.BATTERIES

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._robots: dict[str, _RobotCharge] = {}
        self._has_truth = False

    def handle_state(self, state: RobotState, time_ns: int) -> None:
        """Without ground truth, judge the robot's own report of its battery."""
        robot = self._robots.setdefault(state.robot, _RobotCharge())
        battery = state.battery
        self.cases += not self._has_truth and battery is not None and robot.battery is None
        robot.battery = battery
        if battery is None:
            return
        if battery.charging:
            robot.charged_ns = time_ns
        if self._has_truth:
            return
        if battery.charging or battery.implausible or (battery.soc > EMPTY_SOC and battery.remaining_high_j > 0):
            robot.empty_ns, robot.is_reported = None, False
        elif robot.empty_ns is None:
            robot.empty_ns = time_ns
        elif time_ns - robot.empty_ns > to_ns(EMPTY_AFTER_S) and not robot.is_reported:
            pose = state.pose
            place = None if pose is None or state.lost else Point2D(pose.x_m, pose.y_m)
            self._stranded(state.robot, robot, place, time_ns, is_true=False)

    def handle_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        """Find batteries that have stopped to deliver."""
        if not self._has_truth:
            self._has_truth, self.cases = True, len(truth.robots)
        for now in truth.robots:
            robot = self._robots.setdefault(now.robot, _RobotCharge())
            if robot.energy_j is None or now.energy_j != robot.energy_j:
                robot.energy_j, robot.since_s, robot.is_reported = now.energy_j, truth.sim_time_s, False
            elif truth.sim_time_s - robot.since_s > EMPTY_AFTER_S and not robot.is_reported:
                place = Point2D(now.pose.x_m, now.pose.y_m)
                charges = robot.charged_ns is not None and time_ns - robot.charged_ns < CHARGES_NS
                if not charges and not self.surroundings.is_at_charger(place, SLACK_M):
                    self._stranded(now.robot, robot, place, time_ns, is_true=True)

    def _stranded(self, name: str, robot: _RobotCharge, place: Point2D | None, time_ns: int, *, is_true: bool) -> None:
        robot.is_reported = True
        soc = None if robot.battery is None else robot.battery.soc
        charger_m = None if place is None else self.surroundings.charger_distance_m(place)
        text = f"{name} has no energy left" if is_true else f"{name} reports that it has no energy left"
        if soc is not None:
            text += f" ({100 * soc:.1f} % by its estimate)"
        if place is not None:
            text += f", {_at(place)}"
        if charger_m is not None:
            text += f", {charger_m:.2f} m from the nearest charger"
            charger_m = round(charger_m, 3)
        values = {"robot": name, "place": place, "charger_m": charger_m, "soc": soc, "is_true": is_true}
        self.break_(time_ns, "out_of_energy", text, values)


DEPTH_M = 0.03
"""Least depth of a violation: a solver's remaining overlap, and the raster of the floor (chosen)."""


class Walls(InvariantJudge):
    """Compares true poses with the floor."""

    invariant = Invariant.WALLS

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._radius_m: dict[str, float] = {}
        self._inside: set[str] = set()
        self._last: dict[str, tuple[Pose2D, int]] = {}
        self._has_truth = False

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        if not self._has_truth:
            return MissingEvidence.TRUTH
        if self.surroundings.clearance_m is None:
            return self.surroundings.no_floor
        return None if self.cases else MissingEvidence.RADIUS

    def handle_state(self, state: RobotState, time_ns: int) -> None:
        """Learn the robot's radius."""
        if state.radius_m > 0:
            self._radius_m[state.robot] = state.radius_m

    def handle_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        """Judge the robots' places, and their paths there."""
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
        path = self._path(robot, radius_m, pose, time_ns)
        place = min(path, key=lambda at: clearance_m(at.x_m, at.y_m))
        depth_m = radius_m - clearance_m(place.x_m, place.y_m)
        if depth_m <= DEPTH_M:
            self._inside.discard(robot)
        elif robot not in self._inside:
            self._inside.add(robot)
            text = f"{robot} is {depth_m:.3f} m inside a wall, {_at(place)}"
            self.break_(time_ns, "in_wall", text, {"robot": robot, "place": place, "depth_m": round(depth_m, 4)})

    def _path(self, robot: str, radius_m: float, pose: Pose2D, time_ns: int) -> list[Point2D]:
        """The place, and before it the points on the path there that are a radius apart: no wall fits between them."""
        end = Point2D(pose.x_m, pose.y_m)
        last = self._last.get(robot)
        if last is None:
            return [end]
        (begin, begin_ns), path_m = last, last[0].distance_m(end)
        if path_m <= radius_m or path_m > CARRIED_M_S * to_seconds(time_ns - begin_ns):
            return [end]
        steps = math.ceil(path_m / radius_m)
        return [
            Point2D(begin.x_m + (end.x_m - begin.x_m) * step / steps, begin.y_m + (end.y_m - begin.y_m) * step / steps)
            for step in range(1, steps + 1)
        ]


STOPPED_NS = to_ns(1.0)
"""A halted robot stands after this: the firmware's watchdog, and braking from top speed (chosen: twice that)."""
MOVED_M = 0.05
"""A robot that stands is moved no farther than this, by the ground truth (chosen)."""
OWN_MOVED_M = 0.5
"""The same by its own pose: its path to a stop, and corrections of the pose (chosen), besides three deviations."""
OBEYED_NS = to_ns(2.0)
"""A robot in contact receives a halt within this, from the coordinator's summary at the latest (chosen)."""
RESUMED_NS = to_ns(0.25)
"""After this time a resumed robot has published its own pose again."""
CARRIED_M_S2 = 4.0
"""A standing robot that accelerates faster was carried a short distance (a base accelerates at 0.8 m/s²)."""
STILL_M = 0.01
SHORT_NS = to_ns(0.1)
"""Accelerations are not computed over shorter intervals."""


class _RobotHalt:
    """A robot, as far as halts matter."""

    def __init__(self) -> None:
        self.received_ns = 0
        """Time of its last state."""
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
        self.was_still = False
        """Whether it stood between the last two checks."""


class Halts(InvariantJudge):
    """Follows the team's halt and each robot's.

    A halted robot stands, and a robot in contact with a halted team is halted. While a robot is halted its own pose
    does not change. Without ground truth, the pose at the halt is therefore compared with the first pose after it.
    """

    invariant = Invariant.HALTS

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._robots: dict[str, _RobotHalt] = {}
        self._latch = HaltLatch()
        self._has_truth = False
        self._summary_ns: int | None = None

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        return None if self._robots else MissingEvidence.ROBOTS

    def handle_halt(self, halt: Halt, time_ns: int) -> None:
        """Count the halt; without a coordinator robots must obey it from now on."""
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

    def handle_summary(self, summary: TeamState, time_ns: int) -> None:
        """Judge whether the robots that the coordinator receives obey its halt."""
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
            self._judge_obedience(reported.name, robot, ", ".join(status.by), time_ns)

    def _restart(self) -> None:
        for robot in self._robots.values():
            robot.in_contact_ns = None
            robot.obeys = robot.halted_ns is not None

    def _judge_obedience(self, name: str, robot: _RobotHalt, by: str, time_ns: int) -> None:
        since_ns = robot.in_contact_ns
        if since_ns is None or robot.obeys or time_ns - robot.received_ns > SILENT_NS:
            return
        if time_ns - since_ns > OBEYED_NS:
            robot.obeys = True  # reported once for each halt
            for_s = round(to_seconds(time_ns - since_ns), 3)
            text = f"{name} is not halted although {by or 'somebody'} halted the team {for_s:.1f} s ago"
            self.break_(time_ns, "halt_ignored", text, {"robot": name, "by": by, "for_s": for_s})

    def handle_state(self, state: RobotState, time_ns: int) -> None:
        """Follow the robot's halt; without ground truth, judge whether its own pose has moved."""
        robot = self._robots.setdefault(state.robot, _RobotHalt())
        if self._summary_ns is None and time_ns - robot.received_ns > SILENT_NS:
            robot.in_contact_ns = None  # it missed messages, and no coordinator repeats them
        robot.received_ns = time_ns
        if state.halted:
            robot.obeys = True
            if robot.halted_ns is None:
                self.cases += not self._latch.is_held
                robot.halted_ns, robot.resumed_ns, robot.anchor, robot.is_reported = time_ns, None, None, False
                robot.own = _own_place(state)
            if not self._has_truth and time_ns - robot.halted_ns > STOPPED_NS:
                self._judge_own(robot, state, time_ns)
            return
        if robot.halted_ns is not None and robot.resumed_ns is None:
            robot.resumed_ns = time_ns
            robot.anchor = None
        if robot.resumed_ns is not None and time_ns - robot.resumed_ns >= RESUMED_NS:
            if not self._has_truth:
                self._judge_own(robot, state, time_ns)
            robot.halted_ns = robot.resumed_ns = robot.own = None
        if self._summary_ns is None and self._latch.is_held:
            self._judge_obedience(state.robot, robot, ", ".join(self._latch.holders), time_ns)

    def _judge_own(self, robot: _RobotHalt, state: RobotState, time_ns: int) -> None:
        if robot.own is None or robot.is_reported or state.pose is None:
            return
        now = _own_place(state)
        if now is None:
            robot.own = None
            return
        moved_m = robot.own[0].distance_m(now[0])
        if moved_m > OWN_MOVED_M + 3.0 * (robot.own[1] + now[1]):
            self._moved(state.robot, robot, moved_m, time_ns, is_true=False)

    def handle_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        """Judge whether halted robots stand."""
        self._has_truth = True
        for now in truth.robots:
            robot = self._robots.get(now.robot)
            if robot is None:
                continue
            last, robot.last = robot.last, (now, time_ns)
            halted_ns = robot.halted_ns
            if halted_ns is None or robot.resumed_ns is not None or time_ns - robot.received_ns > SILENT_NS:
                robot.anchor = None
            elif time_ns - halted_ns > STOPPED_NS:
                self._judge_true(now, robot, last, time_ns)

    def _judge_true(
        self, now: RobotTruth, robot: _RobotHalt, last: tuple[RobotTruth, int] | None, time_ns: int
    ) -> None:
        anchor, was_still = robot.anchor, robot.was_still
        robot.was_still = last is not None and now.pose.distance_m(last[0].pose) < STILL_M
        is_carried = last is not None and _was_carried(now, *last, time_ns, was_still=was_still)
        if anchor is None or last is None or now.collisions > anchor.collisions or is_carried:
            robot.anchor = now  # a robot that is pushed or carried does not move by itself
            return
        moved_m = now.pose.distance_m(anchor.pose)
        if moved_m > MOVED_M and not robot.is_reported:
            self._moved(now.robot, robot, moved_m, time_ns, is_true=True)

    def _moved(self, name: str, robot: _RobotHalt, moved_m: float, time_ns: int, *, is_true: bool) -> None:
        assert robot.halted_ns is not None
        robot.is_reported = True
        since_s = self.time_s(robot.halted_ns)
        pose = "" if is_true else " by its own pose"
        text = f"{name} has moved {moved_m:.2f} m{pose} although it is halted since {since_s:g} s"
        values = {"robot": name, "moved_m": round(moved_m, 3), "since_s": since_s, "is_true": is_true}
        self.break_(time_ns, "moved_halted", text, values)


def _own_place(state: RobotState) -> tuple[Point2D, float] | None:
    """Place by its own pose, and its standard deviation; None if it does not know them."""
    if state.pose is None or state.lost or state.frame != ARENA:
        return None
    covariance = state.pose_covariance
    variance_m2 = max(covariance[0] + covariance[4], 0.0) if covariance else 0.0
    return Point2D(state.pose.x_m, state.pose.y_m), variance_m2**0.5


def _was_carried(now: RobotTruth, last: RobotTruth, last_ns: int, time_ns: int, *, was_still: bool) -> bool:
    path_m, duration_s = now.pose.distance_m(last.pose), max(to_seconds(time_ns - last_ns), 0.02)
    if path_m > CARRIED_M_S * duration_s:
        return True
    return was_still and time_ns - last_ns >= SHORT_NS and 2.0 * path_m > CARRIED_M_S2 * duration_s**2


FELL_J = 1e-6
"""Less than this is rounding."""
RISE_SHARE = 0.05
"""Of the energy that was left: so far an interval may miss (chosen; it is one of 95 %)."""
AWAY_NS = to_ns(1.0)
"""A battery that charges away from chargers for this long does so, and was not just moved."""
CHARGER_M = 0.15
"""Beyond a charger's reach that still counts as being there."""
DOUBTED_NS = to_ns(10.0)
"""For this long after measurements were rejected the estimate is not judged."""


class _RobotEnergy:
    """A robot's energy."""

    def __init__(self) -> None:
        self.delivered_j: float | None = None
        self.place: Point2D | None = None
        self.doubted_ns: int | None = None
        self.begin: tuple[BatteryState, float] | None = None
        """Estimate, and delivered energy, at the start of the time since the last charge."""
        self.least_high_j = 0.0
        """The least upper end of the interval in this stretch."""
        self.is_rise_reported = self.is_balance_reported = False
        """Of this stretch."""
        self.away_ns: int | None = None
        self.is_away_reported = False


class EnergyBalance(InvariantJudge):
    """Compares ground truth, chargers and estimates of energy."""

    invariant = Invariant.ENERGY
    evidence = MissingEvidence.BATTERIES

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._robots: dict[str, _RobotEnergy] = {}

    def _robot(self, name: str) -> _RobotEnergy:
        robot = self._robots.setdefault(name, _RobotEnergy())
        self.cases = len(self._robots)
        return robot

    def handle_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        """Judge that delivered energy never falls."""
        for now in truth.robots:
            robot = self._robot(now.robot)
            before_j, now_j = robot.delivered_j, now.energy_j
            if before_j is not None and now_j < before_j - FELL_J:
                text = f"the energy that {now.robot} has used falls from {before_j:.1f} J to {now_j:.1f} J"
                values = {"robot": now.robot, "before_j": before_j, "now_j": now_j}
                self.break_(time_ns, "delivered_fell", text, values)
                robot.begin = None  # later values are counted from here
            robot.delivered_j, robot.place = now_j, Point2D(now.pose.x_m, now.pose.y_m)

    def handle_state(self, state: RobotState, time_ns: int) -> None:
        """Judge the place of a battery that is charged, and the estimate of one that is not."""
        battery = state.battery
        if battery is None:
            return
        robot = self._robot(state.robot)
        if battery.implausible:
            robot.doubted_ns = time_ns
        if state.halted:  # its plugins stand still: it reports its state at the halt
            robot.away_ns = None
        elif battery.charging:
            robot.begin = None
            self._judge_place(state.robot, robot, time_ns)
        else:
            self._judge_estimate(state.robot, robot, battery, time_ns)

    def _judge_estimate(self, name: str, robot: _RobotEnergy, battery: BatteryState, time_ns: int) -> None:
        robot.away_ns, robot.is_away_reported = None, False
        if robot.doubted_ns is not None and time_ns - robot.doubted_ns < DOUBTED_NS:
            robot.begin = None
        elif robot.begin is None:
            robot.begin, robot.least_high_j = (battery, robot.delivered_j or 0.0), battery.remaining_high_j
            robot.is_rise_reported = robot.is_balance_reported = False
        elif battery.remaining_high_j > 0:  # a robot without an interval cannot be judged
            self._judge_rise(name, robot, battery, time_ns)
            self._judge_balance(name, robot, battery, time_ns)
            robot.least_high_j = min(robot.least_high_j, battery.remaining_high_j)

    def _judge_place(self, name: str, robot: _RobotEnergy, time_ns: int) -> None:
        place = robot.place
        if place is None or self.surroundings.chargers is None or self.surroundings.is_at_charger(place, CHARGER_M):
            robot.away_ns = None
            return
        if robot.away_ns is None:
            robot.away_ns = time_ns
        elif time_ns - robot.away_ns > AWAY_NS and not robot.is_away_reported:
            robot.is_away_reported = True
            charger_m = self.surroundings.charger_distance_m(place)
            where = "where no charger is on the floor"
            if charger_m is not None:
                where = f"{charger_m:.2f} m from the nearest charger"
            text = f"{name} charges {_at(place)}, {where}"
            self.break_(time_ns, "charged_away", text, {"robot": name, "place": place, "charger_m": charger_m})

    def _judge_rise(self, name: str, robot: _RobotEnergy, battery: BatteryState, time_ns: int) -> None:
        before_j, now_j = robot.least_high_j, battery.remaining_low_j
        if now_j > before_j * (1.0 + RISE_SHARE) and not robot.is_rise_reported:
            robot.is_rise_reported = True
            text = f"{name} has at least {now_j:.0f} J left after at most {before_j:.0f} J, and was not charged"
            self.break_(time_ns, "charge_rose", text, {"robot": name, "before_j": before_j, "now_j": now_j})

    def _judge_balance(self, name: str, robot: _RobotEnergy, battery: BatteryState, time_ns: int) -> None:
        if robot.begin is None or robot.delivered_j is None or robot.is_balance_reported:
            return
        begin, begun_j = robot.begin
        delivered_j = robot.delivered_j - begun_j
        least_j = begin.remaining_low_j - battery.remaining_high_j
        most_j = begin.remaining_high_j - battery.remaining_low_j
        slack_j = RISE_SHARE * begin.remaining_high_j
        if least_j - slack_j <= delivered_j <= most_j + slack_j:
            return
        robot.is_balance_reported = True
        lost = f"its estimate fell by {least_j:.0f} to {most_j:.0f} J"
        text = f"{name} has used {delivered_j:.0f} J since its last charge, and {lost}"
        figures = {"delivered_j": delivered_j, "least_j": least_j, "most_j": most_j}
        values = {"robot": name, **{key: round(value, 1) for key, value in figures.items()}}
        self.break_(time_ns, "unbalanced", text, values)


MUTUAL_WAIT_NS = to_ns(30.0)
"""Two robots may wait for each other for this long."""


class MutualWait(InvariantJudge):
    """Finds pairs of robots that block each other: each reports that it waits for the other."""

    invariant = Invariant.MUTUAL_WAIT
    evidence = MissingEvidence.ROBOTS

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._waiting: dict[str, tuple[str, int, int]] = {}
        """Of each robot: for whom it waits, since when, and the time of its last report."""
        self._reported: dict[str, int] = {}
        """Since when the wait of a robot had lasted that was reported last."""

    def handle_state(self, state: RobotState, time_ns: int) -> None:
        """Follow for whom the robot waits; a robot that halts waits for nobody."""
        name, other = state.robot, "" if state.halted else state.waits_for
        before, since_ns, last_ns = self._waiting.get(name, ("", 0, 0))
        if other != before or time_ns - last_ns > SILENT_NS:
            since_ns = time_ns
        self._waiting[name] = other, since_ns, time_ns
        self.cases = len(self._waiting)
        theirs, their_since_ns, seen_ns = self._waiting.get(other, ("", 0, 0))
        if theirs != name or time_ns - seen_ns > SILENT_NS:
            return
        both_ns = max(since_ns, their_since_ns)
        if time_ns - both_ns > MUTUAL_WAIT_NS and self._reported.get(other) != both_ns:
            self._reported[name] = self._reported[other] = both_ns
            for_s = round(to_seconds(time_ns - both_ns), 3)
            text = f"{name} and {other} have waited for each other for {for_s:.1f} s"
            self.break_(time_ns, "mutual_wait", text, {"robot": name, "other": other, "for_s": for_s})


def _at(place: Point2D) -> str:
    return f"at x {place.x_m:.2f}, y {place.y_m:.2f}"
