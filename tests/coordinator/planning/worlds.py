"""Fake robots that drive, work and get tired, for tests of the coordinator's planning."""

import math

import msgspec

from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.energy_model import EnergyModel
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.stock_kinds import Recharge
from robrain.protocol.model.tasks.task import TaskState, parameters_of
from tests.coordinator.conftest import TICK_S, FakeRobot, Team
from tests.energy_models import energy_model

STANDING_W = 8.0
J_PER_M = 20.0
PACE_M_S = 0.5
CAPACITY_J = 100_000.0
CHARGE_W = 2000.0
"""Quick, so that tests are."""
BESIDE_M = 1.3
COVARIANCE = (0.01, *([0.0] * 14))


def model(usable_j: float, *, dearer: float = 1.0, pace_m_s: float = PACE_M_S) -> EnergyModel:
    """A robot of 8 W standing that takes 20 J more a metre, known well."""
    return energy_model(
        STANDING_W,
        0.0,
        dearer * J_PER_M,
        0.0,
        0.0,
        covariance=COVARIANCE,
        residual_w2_s=1.0,
        drift_w2_per_s=1e-5,
        relative_sd=0.03,
        pace_m_s=pace_m_s,
        usable_j=usable_j,
    )


class Worker:
    """Makes a fake robot do what it is told, in straight lines."""

    def __init__(self, robot: FakeRobot, *, remaining_j: float, dearer: float = 1.0) -> None:
        self.robot = robot
        self.remaining_j = remaining_j
        self.dearer = dearer
        self.spent_j = 0.0
        self.least_j = remaining_j
        self.done: list[str] = []
        self.at_charger: Point2D | None = None
        self.mates: list[Worker] = []
        """The others: at a charger that one of them has it waits beside, as real robots do."""
        self.waited_s = 0.0
        """So long it waited there, the longest time."""
        self._waits_s = 0.0
        self._working_s = 0.0
        self._at = ""
        self.tell()

    def tell(self) -> None:
        """What its next state says of its battery."""
        robot = self.robot
        robot.battery = BatteryState(
            voltage_v=16.0,
            current_a=1.0,
            temperature_c=20.0,
            soc=self.remaining_j / CAPACITY_J,
            remaining_j=self.remaining_j,
            remaining_low_j=self.remaining_j,
            remaining_high_j=self.remaining_j,
            charging=self.at_charger is not None,
        )
        robot.energy = model(self.remaining_j, dearer=self.dearer)

    def step(self, dt_s: float) -> None:
        """Go on with the task."""
        robot, status = self.robot, self.robot.task
        self._spend(STANDING_W * dt_s)
        if status is None or status.state.ended or not robot.offers:
            self.at_charger = None
        else:
            self._work(robot.offers[-1].task, dt_s)
        self.tell()

    def _work(self, task, dt_s: float) -> None:
        robot = self.robot
        if self._at != task.id:
            self._at, self._working_s = task.id, 0.0
            self.at_charger = None  # it may have been called away from one
        place = task.place
        away_m = math.hypot(place.x_m - robot.pose.x_m, place.y_m - robot.pose.y_m)
        go_m = min(away_m, PACE_M_S * dt_s)
        if task.kind == "recharge" and away_m <= BESIDE_M and any(mate.at_charger == place for mate in self.mates):
            self._waits_s += dt_s
            self.waited_s = max(self.waited_s, self._waits_s)
            return
        self._waits_s = 0.0
        if go_m > 0:
            share = go_m / away_m
            x_m = robot.pose.x_m + share * (place.x_m - robot.pose.x_m)
            y_m = robot.pose.y_m + share * (place.y_m - robot.pose.y_m)
            robot.pose = Pose2D(x_m, y_m, 0.0)
            self._spend(self.dearer * J_PER_M * go_m)
            return
        if task.kind == "recharge":
            self.at_charger = place
            self.remaining_j = min(CAPACITY_J, self.remaining_j + CHARGE_W * dt_s)
            if self.remaining_j < parameters_of(task, Recharge).until_soc * CAPACITY_J:
                return
        else:
            self._working_s += dt_s
            if self._working_s < task.service_s:
                return
            self.done.append(task.id)
        self.at_charger = None
        robot.end(TaskState.DONE)

    def _spend(self, energy_j: float) -> None:
        self.spent_j += energy_j
        self.remaining_j -= energy_j
        self.least_j = min(self.least_j, self.remaining_j)


def run(team: Team, workers: list[Worker], duration_s: float, *, until=lambda: False, check=lambda: None) -> bool:
    """Run team and robots; True as soon as `until` says so."""
    for worker in workers:
        worker.mates = [other for other in workers if other is not worker]
    for _ in range(round(duration_s / (5 * TICK_S))):
        for worker in workers:
            worker.step(5 * TICK_S)
        team.run(5 * TICK_S)
        check()
        if until():
            return True
    return False


def replaced(task, **fields):
    """A task with other fields."""
    return msgspec.structs.replace(task, **fields)
