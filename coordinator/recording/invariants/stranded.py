"""Nobody is stranded: no robot is without energy away from a charger.

With ground truth it is certain: a battery that has cut off delivers nothing, and a robot that stands draws power.
Without it the robot's own estimate is all there is.
"""

from collections.abc import Mapping

from robrain.coordinator.recording.invariants.findings import Invariant, Missing, OutOfEnergy
from robrain.coordinator.recording.invariants.invariant_judge import Handler, InvariantJudge, Surroundings
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.wire.messages.team.arena_messages import ArenaTruth, RobotTruth

EMPTY_AFTER_S = 2.0
"""A battery that has delivered nothing for this long has cut off (chosen: ten periods of the battery manager)."""
EMPTY_SOC = 0.001
"""State of charge below which a robot says that it is empty."""
CHARGES_NS = to_ns(5.0)
"""A robot that reported to be charged no longer ago is at a charger."""
SLACK_M = 0.1
"""Beyond a charger's reach that still counts as being there."""


class _Robot:
    """A robot's energy."""

    def __init__(self) -> None:
        self.state: RobotState | None = None
        self.charged_ns: int | None = None
        """When it last said that it is charged."""
        self.energy_j: float | None = None
        self.since_s = 0.0
        """Since when the truth has had the same `energy_j`."""
        self.empty_ns: int | None = None
        """Since when it has said that it is empty."""
        self.is_told = False


class NotStranded(InvariantJudge):
    """Looks for robots whose batteries give nothing."""

    invariant = Invariant.NOT_STRANDED

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._robots: dict[str, _Robot] = {}
        self._has_truth = False

    def handlers(self) -> Mapping[type, Handler]:
        """What is to be called with each type of message."""
        return {RobotState: self._take_state, ArenaTruth: self._take_truth}

    def lacks(self) -> Missing | None:
        """What the messages lacked."""
        return None if self.cases else Missing.BATTERIES

    def _take_state(self, state: RobotState, time_ns: int) -> None:
        robot = self._robots.setdefault(state.robot, _Robot())
        battery = state.battery
        self.cases += not self._has_truth and battery is not None and _battery_of(robot) is None
        robot.state = state
        if battery is None:
            return
        if battery.charging:
            robot.charged_ns = time_ns
        if self._has_truth:
            return
        if battery.charging or battery.implausible or (battery.soc > EMPTY_SOC and battery.remaining_high_j > 0):
            robot.empty_ns, robot.is_told = None, False
        elif robot.empty_ns is None:
            robot.empty_ns = time_ns
        elif time_ns - robot.empty_ns > to_ns(EMPTY_AFTER_S) and not robot.is_told:
            pose = state.pose
            place = None if pose is None or state.lost else Point2D(pose.x_m, pose.y_m)
            self._stranded(state.robot, robot, place, time_ns, is_true=False)

    def _take_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        if not self._has_truth:
            self._has_truth, self.cases = True, len(truth.robots)
        for now in truth.robots:
            robot = self._robots.setdefault(now.robot, _Robot())
            if robot.energy_j is None or now.energy_j != robot.energy_j:
                robot.energy_j, robot.since_s, robot.is_told = now.energy_j, truth.sim_time_s, False
            elif truth.sim_time_s - robot.since_s > EMPTY_AFTER_S and not robot.is_told:
                self._judge_empty(now, robot, time_ns)

    def _judge_empty(self, now: RobotTruth, robot: _Robot, time_ns: int) -> None:
        place = Point2D(now.pose.x_m, now.pose.y_m)
        charges = robot.charged_ns is not None and time_ns - robot.charged_ns < CHARGES_NS
        if not charges and not self.surroundings.is_at_charger(place, SLACK_M):
            self._stranded(now.robot, robot, place, time_ns, is_true=True)

    def _stranded(self, name: str, robot: _Robot, place: Point2D | None, time_ns: int, *, is_true: bool) -> None:
        robot.is_told = True
        battery = _battery_of(robot)
        charger_m = None if place is None else self.surroundings.charger_distance_m(place)
        finding = OutOfEnergy(
            robot=name,
            place=place,
            charger_m=None if charger_m is None else round(charger_m, 3),
            soc=None if battery is None else battery.soc,
            is_true=is_true,
        )
        self.break_(time_ns, finding)


def _battery_of(robot: _Robot) -> BatteryState | None:
    return None if robot.state is None else robot.state.battery
