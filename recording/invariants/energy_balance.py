"""Energy balances: what batteries have delivered never falls, and their charge rises at chargers only.

The estimates of robots are judged by their intervals alone, and only between two charges.
"""

from collections.abc import Mapping

from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.wire.messages.team.arena_messages import ArenaTruth
from robrain.recording.invariants.findings import (
    ChargedAway,
    ChargeRose,
    DeliveredFell,
    Invariant,
    MissingEvidence,
    Unbalanced,
)
from robrain.recording.invariants.invariant_judge import Handler, InvariantJudge, Surroundings

FELL_J = 1e-6
"""Less than this is rounding."""
RISE_SHARE = 0.05
"""Of the energy that was left: so far an interval may miss (chosen; it is one of 95 %)."""
AWAY_NS = to_ns(1.0)
"""A battery that charges away from chargers for this long does so, and was not just moved."""
SLACK_M = 0.15
"""Beyond a charger's reach that still counts as being there."""
DOUBTED_NS = to_ns(10.0)
"""For this long after measurements were rejected the estimate is not judged."""


class _Robot:
    """A robot's energy."""

    def __init__(self) -> None:
        self.delivered_j: float | None = None
        self.place: Point2D | None = None
        self.doubted_ns: int | None = None
        self.begin: tuple[BatteryState, float] | None = None
        """Estimate, and what was delivered, at the start of the stretch since the last charge."""
        self.least_high_j = 0.0
        """The least upper end of the interval in this stretch."""
        self.is_told = self.is_balance_told = False
        """Of this stretch."""
        self.away_ns: int | None = None
        self.is_away_told = False


class EnergyBalance(InvariantJudge):
    """Compares ground truth, chargers and estimates of energy."""

    invariant = Invariant.ENERGY

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._robots: dict[str, _Robot] = {}

    def handlers(self) -> Mapping[type, Handler]:
        """What is to be called with each type of message."""
        return {RobotState: self._take_state, ArenaTruth: self._take_truth}

    def lacks(self) -> MissingEvidence | None:
        """What the messages lacked."""
        return None if self.cases else MissingEvidence.BATTERIES

    def _robot(self, name: str) -> _Robot:
        robot = self._robots.get(name)
        if robot is None:
            robot = self._robots[name] = _Robot()
            self.cases += 1
        return robot

    def _take_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        for now in truth.robots:
            robot = self._robot(now.robot)
            before_j = robot.delivered_j
            if before_j is not None and now.energy_j < before_j - FELL_J:
                self.break_(time_ns, DeliveredFell(robot=now.robot, before_j=before_j, now_j=now.energy_j))
                robot.begin = None  # what follows is counted from here
            robot.delivered_j, robot.place = now.energy_j, Point2D(now.pose.x_m, now.pose.y_m)

    def _take_state(self, state: RobotState, time_ns: int) -> None:
        battery = state.battery
        if battery is None:
            return
        robot = self._robot(state.robot)
        if battery.implausible:
            robot.doubted_ns = time_ns
        if state.halted:  # its plugins stand still: it tells what it knew when it was halted
            robot.away_ns = None
        elif battery.charging:
            robot.begin = None
            self._judge_place(state.robot, robot, time_ns)
        else:
            self._judge_estimate(state.robot, robot, battery, time_ns)

    def _judge_estimate(self, name: str, robot: _Robot, battery: BatteryState, time_ns: int) -> None:
        robot.away_ns, robot.is_away_told = None, False
        if robot.doubted_ns is not None and time_ns - robot.doubted_ns < DOUBTED_NS:
            robot.begin = None
        elif robot.begin is None:
            robot.begin, robot.least_high_j = (battery, robot.delivered_j or 0.0), battery.remaining_high_j
            robot.is_told = robot.is_balance_told = False
        elif battery.remaining_high_j > 0:  # a robot that tells no interval has nothing to judge
            self._judge_rise(name, robot, battery, time_ns)
            self._judge_balance(name, robot, battery, time_ns)
            robot.least_high_j = min(robot.least_high_j, battery.remaining_high_j)

    def _judge_place(self, name: str, robot: _Robot, time_ns: int) -> None:
        place = robot.place
        if place is None or self.surroundings.chargers is None or self.surroundings.is_at_charger(place, SLACK_M):
            robot.away_ns = None
            return
        if robot.away_ns is None:
            robot.away_ns = time_ns
        elif time_ns - robot.away_ns > AWAY_NS and not robot.is_away_told:
            robot.is_away_told = True
            self.break_(
                time_ns, ChargedAway(robot=name, place=place, charger_m=self.surroundings.charger_distance_m(place))
            )

    def _judge_rise(self, name: str, robot: _Robot, battery: BatteryState, time_ns: int) -> None:
        before_j, now_j = robot.least_high_j, battery.remaining_low_j
        if now_j > before_j * (1.0 + RISE_SHARE) and not robot.is_told:
            robot.is_told = True
            self.break_(time_ns, ChargeRose(robot=name, before_j=before_j, now_j=now_j))

    def _judge_balance(self, name: str, robot: _Robot, battery: BatteryState, time_ns: int) -> None:
        if robot.begin is None or robot.delivered_j is None or robot.is_balance_told:
            return
        begin, begun_j = robot.begin
        delivered_j = robot.delivered_j - begun_j
        least_j = begin.remaining_low_j - battery.remaining_high_j
        most_j = begin.remaining_high_j - battery.remaining_low_j
        slack_j = RISE_SHARE * begin.remaining_high_j
        if least_j - slack_j <= delivered_j <= most_j + slack_j:
            return
        robot.is_balance_told = True
        finding = Unbalanced(
            robot=name, delivered_j=round(delivered_j, 1), least_j=round(least_j, 1), most_j=round(most_j, 1)
        )
        self.break_(time_ns, finding)
