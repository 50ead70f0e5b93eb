import msgspec
import numpy as np
import pytest

from robrain.algorithms.energy.consumption import Consumption, Drawn, PowerLearner, PowerPrior
from robrain.protocol.model.energy_model import Work, estimate

TRUE = (9.0, 0.3, 12.0, 1.0, 10.0)
NS = 1_000_000_000


class Robot:
    """Draws what `TRUE` says, at 5 Hz, and is watched."""

    def __init__(self, noise_w: float = 0.3) -> None:
        self.consumption = Consumption(PowerPrior(), 0.001, 0.03)
        self.rng = np.random.default_rng(1)
        self.noise_w = noise_w
        self.idle_w = TRUE[0]
        self.stamp_ns = 0
        self.energy_j = 0.0
        self.speed_m_s = 0.0

    def go(self, seconds: float, speed_m_s: float = 0.0, yaw_rad_s: float = 0.0, *, trusted: bool = True) -> float:
        """What it took."""
        before_j = self.energy_j
        for _ in range(round(seconds / 0.2)):
            gained = max(0.0, 0.5 * (speed_m_s**2 - self.speed_m_s**2))
            mean_m_s = 0.5 * (speed_m_s + self.speed_m_s)
            self.speed_m_s = speed_m_s
            moving = mean_m_s > 0 or yaw_rad_s > 0
            power_w = self.idle_w + TRUE[1] * moving + TRUE[2] * mean_m_s + TRUE[3] * yaw_rad_s
            self.energy_j += power_w * 0.2 + TRUE[4] * gained + self.rng.normal(0.0, self.noise_w) * 0.2
            self.stamp_ns += NS // 5
            self.consumption.move(self.stamp_ns, speed_m_s, yaw_rad_s)
            self.consumption.draw(Drawn(self.stamp_ns, self.energy_j, trusted))
        return self.energy_j - before_j

    def live(self, minutes: int) -> None:
        for _ in range(minutes):
            self.go(10.0)
            self.go(20.0, self.rng.uniform(0.3, 0.8))
            self.go(5.0, 0.0, self.rng.uniform(0.5, 1.5))
            self.go(20.0, self.rng.uniform(0.3, 0.8))
            self.go(5.0)


def test_what_things_cost_is_learned_from_what_they_did_cost():
    robot = Robot()
    robot.live(15)
    model = robot.consumption.model(0.0)
    assert model.coefficients[0] == pytest.approx(TRUE[0], abs=0.1)
    assert model.coefficients[2] == pytest.approx(TRUE[2], abs=0.8)
    cost_j = robot.go(40.0, 0.5)
    told = estimate(model, Work(path_m=20.0, speed_m_s=0.5))
    assert told.mean_j == pytest.approx(cost_j, rel=0.02)
    assert told.low_j(0.99) < cost_j < told.high_j(0.99)


def test_a_computer_that_takes_more_from_now_on_is_followed():
    robot = Robot()
    robot.live(10)
    robot.idle_w = 14.0
    robot.live(20)
    assert robot.consumption.model(0.0).coefficients[0] == pytest.approx(14.0, abs=1.0)


def test_an_hours_wait_does_not_make_it_forget_what_driving_costs():
    robot = Robot()
    robot.live(15)
    before = robot.consumption.model(0.0)
    robot.go(3600.0)
    after = robot.consumption.model(0.0)
    work = Work(path_m=100.0, speed_m_s=0.5)
    assert estimate(after, work).mean_j == pytest.approx(estimate(before, work).mean_j, rel=0.02)
    assert estimate(after, work).sigma_j < 1.5 * estimate(before, work).sigma_j


def test_the_covariance_stays_one():
    learner = PowerLearner(PowerPrior())
    rng = np.random.default_rng(1)
    for _ in range(3000):
        speed_m_s = rng.choice([0.0, 0.5])
        learner.learn((2.0, 2.0 * (speed_m_s > 0), 2.0 * speed_m_s, 0.0, 0.0), rng.normal(20.0, 3.0))
    assert np.linalg.eigvalsh(learner._covariance).min() > 0
    assert msgspec.json.encode(learner.covariance)
