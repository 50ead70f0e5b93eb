"""Halls and corridors wider or longer than the lidar reaches: odometry carries the robots where scans show nothing."""

import pytest

from robrain import Scenario
from robrain.protocol.model.accuracy import PoseAccuracy
from robrain.protocol.model.geometry import Point2D
from robrain.sim.lockstep.result import RunResult
from robrain.sim.maps.drawing import FloorDrawing
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.robot.wheels import WheelSpec

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
ERROR_MAX_M = 0.05
"""Largest position error of a robot with exact wheels; odometry alone is good to 13 mm."""
NEES_BAND = {1: (0.05, 7.4), 2: (0.24, 5.6)}
"""95 % band of the mean of so many chi-square variables of two degrees of freedom (the errors of a run correlate)."""


def explored(
    width_m: float,
    height_m: float,
    robots: int,
    seed: int,
    hardware: RobotHardware = RobotHardware(),  # noqa: B008 - immutable, so a shared default is safe
    *,
    time_limit_s: float = 400.0,
    until_explored: float = 0.95,
) -> RunResult:
    hall = Scenario(
        name="hall",
        floor=FloorDrawing(size_m=(width_m, height_m), resolution_m=0.1),
        robots=robots,
        seed=seed,
        near=Point2D(0.5 * width_m if width_m == height_m else 4.0, 0.5 * height_m),
        hardware=hardware,
    )
    return hall.run(until_explored=until_explored, time_limit_s=time_limit_s)


def accuracies(result: RunResult) -> list[PoseAccuracy]:
    return [robot.pose_accuracy for robot in result.per_robot if robot.pose_accuracy is not None]


@pytest.mark.parametrize(
    ("width_m", "height_m", "robots", "seed", "until_explored", "longest_s"),
    [(30.0, 30.0, 1, 1, 0.4, 100.0), (80.0, 3.0, 2, 1, 0.4, 100.0)],
)
def test_open_floor_is_explored_and_no_robot_loses_its_place(
    width_m: float, height_m: float, robots: int, seed: int, until_explored: float, longest_s: float
) -> None:
    result = explored(width_m, height_m, robots, seed, until_explored=until_explored)
    assert result.ended == "explored"
    assert result.sim_time_s < longest_s
    found = accuracies(result)
    assert [(each.lost_s, each.silent_divergence_s) for each in found] == [(0.0, 0.0)] * robots
    assert max(each.max_error_m or 0.0 for each in found) < ERROR_MAX_M
    least, most = NEES_BAND[robots]
    assert least < sum(each.nees or 0.0 for each in found) / robots < most
    assert result.map_accuracy is not None
    assert result.map_accuracy.cells_off == 0


def test_covariance_of_slipping_wheels_describes_the_error_and_a_lost_robot_has_not_explored_the_floor() -> None:
    wheels = WheelSpec(radius_sigma=0.01, base_sigma=0.01, slip=0.01, slip_sigma_m_per_sqrt_m=0.01)
    result = explored(30.0, 30.0, 1, 1, RobotHardware(wheels=wheels), time_limit_s=40.0)
    (accuracy,) = accuracies(result)
    assert result.ended == "time_limit"
    assert result.explored_fraction < 0.9
    assert accuracy.silent_divergence_s == 0.0
    least, most = NEES_BAND[1]
    assert accuracy.nees is not None
    assert least < accuracy.nees < most
