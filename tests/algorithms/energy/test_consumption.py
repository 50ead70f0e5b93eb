"""How a robot learns its consumption: integrals of motion, lessons, outcomes, batches."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.energy.consumption import (
    OUTCOME_MOST,
    PACE_OVER_S,
    PRIOR_OUTCOMES,
    Consumption,
    Drawn,
    MotionTerms,
    PowerLearner,
    PowerPrior,
)
from robrain.protocol.clock import to_ns
from robrain.protocol.model.energy_model import EnergyEstimate, Work, estimate
from tests.energy_models import energy_model

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
    cost = estimate(model, Work(path_m=20.0, speed_m_s=0.5))
    assert cost.mean_j == pytest.approx(cost_j, rel=0.02)
    assert cost.low_j(0.99) < cost_j < cost.high_j(0.99)


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


PRIOR = PowerPrior()


def terms(*samples):
    """Integrals of samples (time, speed, yaw rate)."""
    one = MotionTerms()
    for at_s, speed_m_s, yaw_rate_rad_s in samples:
        one.move(to_ns(at_s), speed_m_s, yaw_rate_rad_s)
    return one


def test_speeds_between_samples_change_evenly():
    one = terms((10.0, 0.0, 0.2), (10.4, 0.6, 0.4), (10.8, 0.2, 0.0), (11.0, 0.4, 0.0))
    amounts = one.between(to_ns(10.0), to_ns(11.0))
    path_m = 0.3 * 0.4 + 0.4 * 0.4 + 0.3 * 0.2
    turned_rad = 0.3 * 0.4 + 0.2 * 0.4
    started = 0.5 * 0.6**2 + 0.5 * (0.4**2 - 0.2**2)  # braking recovers nothing
    assert amounts == pytest.approx((1.0, 1.0, path_m, turned_rad, started))


def consumption(relative_sd=0.05):
    return Consumption(PRIOR, 0.001, relative_sd)


class SteadyRobot:
    """Drives at 0.5 m/s and draws 20 W, at 5 Hz."""

    def __init__(self):
        self.learns = consumption()
        self.at_s, self.energy_j = 0.0, 100.0
        self.lessons = []
        self.learns.learner.learn = lambda amounts, energy_j: self.lessons.append((amounts, energy_j))

    def go(self, seconds, *, trusted=True, moves=True):
        drawn = []
        for _ in range(round(seconds / 0.2)):
            if moves:
                self.learns.move(to_ns(self.at_s), 0.5, 0.0)
            drawn.append(self.learns.draw(Drawn(to_ns(self.at_s), self.energy_j, trusted)))
            self.at_s = round(self.at_s + 0.2, 6)
            self.energy_j += 4.0
        return drawn


def test_what_is_not_trusted_ends_a_lesson_and_the_next_begins_after_it():
    robot = SteadyRobot()
    robot.go(1.6)
    assert robot.go(0.2, trusted=False) == [False]
    assert not any(robot.go(2.0))
    assert robot.go(0.2) == [True]
    assert robot.lessons[0][1] == pytest.approx(40.0)


def test_count_that_begins_anew_begins_a_lesson_anew_and_one_that_stands_still_does_not():
    robot = SteadyRobot()
    robot.go(1.6)
    robot.energy_j = 0.0
    assert not any(robot.go(2.0))
    assert robot.go(0.2) == [True]
    still = SteadyRobot()
    for number in range(11):
        still.learns.move(to_ns(0.2 * number), 0.5, 0.0)
        is_lesson = still.learns.draw(Drawn(to_ns(0.2 * number), 100.0, True))
    assert is_lesson
    assert still.lessons[0][1] == 0.0


WAY = Work(path_m=20.0)


def test_way_that_cost_more_raises_the_ratio_by_its_share_and_one_that_went_wrong_counts_as_the_most():
    for share, counted in ((0.1, 0.1), (-0.2, -0.2), (5.0, OUTCOME_MOST), (-0.9, -OUTCOME_MOST)):
        one = consumption()
        planned_j = estimate(one.model(0.0), WAY).mean_j
        one.compare(WAY, planned_j * (1.0 + share))
        assert one.model(0.0).path_ratio == pytest.approx(1.0 + counted / (PRIOR_OUTCOMES + 1), abs=1e-4)


def test_spread_of_ways_grows_by_what_the_power_alone_does_not_explain():
    one = consumption(0.05)
    model = one.model(0.0)
    planned = estimate(model, WAY)
    known = (planned.sigma_j**2 - (0.05 * planned.mean_j) ** 2) / planned.mean_j**2
    assert 0.0 < known < 0.3**2
    one.compare(WAY, planned.mean_j * 1.25)
    expected = 0.05**2 + (max(0.0, 0.25**2 - known) - 0.05**2) / (PRIOR_OUTCOMES + 1)
    assert one.model(0.0).relative_sd == pytest.approx(math.sqrt(expected), abs=1e-4)
    calm = consumption(0.05)
    calm.compare(WAY, planned.mean_j)
    assert calm.model(0.0).relative_sd == pytest.approx(0.05 * math.sqrt(0.8), abs=1e-4)


def test_lesson_moves_the_mean_and_the_covariance_as_least_squares_with_directional_forgetting_does():
    learner = PowerLearner(PRIOR)
    mean = np.array([8.0, 0.4, 9.0, 1.5, 8.0])
    covariance = np.diag(np.square([3.0, 0.5, 4.0, 0.7, 3.0]))
    drift = 1.0 / 3600.0
    for amounts, energy_j in (((2.0, 2.0, 1.0, 0.4, 0.1), 40.0), ((2.5, 0.0, 0.0, 0.0, 0.0), 19.0)):
        duration_s = amounts[0]
        factors = np.array(amounts) / duration_s
        keeps = math.exp(-duration_s / PRIOR.memory_s)
        covariance[0, 0] += drift * duration_s
        informed = factors @ np.linalg.solve(covariance, factors)
        prior = covariance + (1.0 - keeps) / keeps / informed * np.outer(factors, factors)
        gain = prior @ factors / (factors @ prior @ factors + PRIOR.residual_w2_s / duration_s)
        mean = mean + gain * (energy_j / duration_s - factors @ mean)
        covariance = prior - np.outer(gain, prior @ factors)
        learner.learn(amounts, energy_j)
    assert learner.coefficients == pytest.approx(mean, rel=1e-4)
    lower = [covariance[row, column] for row in range(5) for column in range(row + 1)]
    assert learner.covariance == pytest.approx(lower, rel=1e-3, abs=1e-9)


def test_pace_is_that_of_ways_and_the_turn_rate_that_of_turns_on_the_spot():
    learner = PowerLearner(PRIOR)
    learner.pass_by(0.3, 2.0, 6.0)
    assert (learner.pace_m_s, learner.turn_rate_rad_s) == (pytest.approx(0.5 - 0.2 * 6.0 / PACE_OVER_S), 1.2)
    learner.pass_by(0.01, 2.0, 6.0)
    assert learner.turn_rate_rad_s == pytest.approx(1.2 + 0.8 * 6.0 / PACE_OVER_S)
    before = (learner.pace_m_s, learner.turn_rate_rad_s)
    learner.pass_by(0.01, 0.01, 6.0)
    assert (learner.pace_m_s, learner.turn_rate_rad_s) == before
    learner.pass_by(0.4, 0.0, 600.0)
    assert learner.pace_m_s == pytest.approx(0.4)


MODEL = energy_model(8.0, 0.5, 10.0, 2.0, 8.0, packet_j=0.001)
AMOUNTS = st.floats(0.0, 1e4)
WORKS = st.builds(Work, AMOUNTS, AMOUNTS, AMOUNTS, st.integers(0, 1000), st.none() | st.floats(0.05, 2.0))


def test_a_wait_costs_what_standing_costs():
    assert estimate(MODEL, Work(wait_s=60.0)) == EnergyEstimate(480.0, 0.0, 60.0)


def test_a_way_costs_its_time_its_length_and_one_start():
    cost = estimate(MODEL, Work(path_m=10.0))
    assert cost.duration_s == 20.0
    assert cost.mean_j == pytest.approx(20.0 * 8.5 + 10.0 * 10.0 + 0.5 * 0.5**2 * 8.0)


def test_a_turn_costs_its_time_and_its_angle():
    assert estimate(MODEL, Work(turn_rad=3.0)).mean_j == pytest.approx(3.0 * 8.5 + 3.0 * 2.0)


def test_a_faster_way_takes_less_time_and_so_less_of_the_computers_power():
    slow, fast = (estimate(MODEL, Work(path_m=10.0, speed_m_s=speed_m_s)) for speed_m_s in (0.25, 1.0))
    assert (slow.duration_s, fast.duration_s) == (40.0, 10.0)
    assert slow.mean_j > fast.mean_j


def test_every_source_of_doubt_widens_the_interval():
    work = Work(path_m=20.0, wait_s=100.0)
    variance = [0.0] * 15
    variance[0] = 0.25
    for change in (
        {"covariance": tuple(variance)},
        {"residual_w2_s": 4.0},
        {"relative_sd": 0.05},
        {"drift_w2_per_s": 1e-3},
    ):
        assert estimate(msgspec.structs.replace(MODEL, **change), work).sigma_j > 10.0
    unexplained = msgspec.structs.replace(MODEL, residual_w2_s=4.0)
    assert estimate(unexplained, Work(wait_s=100.0)).sigma_j == pytest.approx(20.0)


@pytest.mark.parametrize(("wait_s", "sigma_j"), [(30.0, 3.0), (300.0, 94.868)])
def test_standing_power_that_wanders_counts_with_the_third_power_of_the_time(wait_s, sigma_j):
    wandering = msgspec.structs.replace(MODEL, drift_w2_per_s=1e-3)
    assert estimate(wandering, Work(wait_s=wait_s)).sigma_j == pytest.approx(sigma_j, rel=1e-4)


def test_the_way_alone_turns_out_other_than_planned():
    unsure = msgspec.structs.replace(MODEL, relative_sd=0.1, path_ratio=1.2)
    way_j = 1.2 * estimate(MODEL, Work(path_m=10.0)).mean_j
    cost = estimate(unsure, Work(path_m=10.0, wait_s=60.0, radio_packets=1000))
    assert cost.sigma_j == pytest.approx(0.1 * way_j)
    assert cost.mean_j == pytest.approx(way_j + 480.0 + 1.0)


@given(WORKS, WORKS)
def test_two_works_cost_as_much_as_both_together_but_for_one_start(one, other):
    if one.path_m > 0 and other.path_m > 0 and (one.speed_m_s is None) != (other.speed_m_s is None):
        with pytest.raises(ValueError, match="estimate each by itself"):
            _ = one + other
        return
    apart_j = estimate(MODEL, one).mean_j + estimate(MODEL, other).mean_j
    assert estimate(MODEL, one + other).mean_j == pytest.approx(apart_j, rel=1e-6, abs=2 * 0.5 * 2.0**2 * 8.0)


@given(WORKS, WORKS)
def test_more_work_never_costs_less(work, more):
    assert estimate(MODEL, work + Work(0.0, more.turn_rad, more.wait_s)).mean_j >= estimate(MODEL, work).mean_j


@given(st.floats(0.5, 0.999), st.floats(0.501, 0.999))
def test_bounds_are_ordered_and_costs_are_never_negative(confidence, other):
    cost = EnergyEstimate(100.0, 60.0, 10.0)
    assert 0.0 <= cost.low_j(confidence) <= cost.mean_j <= cost.high_j(confidence)
    if other > confidence:
        assert cost.high_j(other) >= cost.high_j(confidence)
    assert cost.high_j(0.95) == pytest.approx(100.0 + 1.644854 * 60.0)
