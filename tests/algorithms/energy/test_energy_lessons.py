"""How a robot learns its consumption: integrals of motion, lessons, outcomes, batches."""

import math

import numpy as np
import pytest

from robrain.algorithms.energy.consumption import (
    BATCH_S,
    LESSON_MAX_S,
    OUTCOME_MOST,
    PACE_OVER_S,
    POWER_OVER_S,
    PRIOR_BATCHES,
    PRIOR_OUTCOMES,
    USUAL_OVER_S,
    Consumption,
    Drawn,
    MotionTerms,
    PowerLearner,
    PowerPrior,
)
from robrain.protocol.clock import to_ns
from robrain.protocol.model.energy_model import Work, estimate

PRIOR = PowerPrior()


# -- integrals of motion ----------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(
    ("speed_m_s", "yaw_rate_rad_s", "moving_s"), [(0.01, 0.01, 0.0), (0.011, 0.0, 0.4), (0.0, 0.011, 0.4)]
)
def test_time_counts_as_moving_above_the_noise_of_the_encoders(speed_m_s, yaw_rate_rad_s, moving_s):
    one = terms((0.0, speed_m_s, yaw_rate_rad_s), (0.4, speed_m_s, yaw_rate_rad_s))
    assert one.between(0, to_ns(0.4))[1] == pytest.approx(moving_s)


# -- lessons ----------------------------------------------------------------------------------------------------


def consumption(relative_sd=0.05):
    return Consumption(PRIOR, 0.001, relative_sd)


class Robot:
    """Drives at 0.5 m/s and draws 20 W, at 5 Hz."""

    def __init__(self):
        self.learns = consumption()
        self.at_s, self.energy_j = 0.0, 100.0
        self.lessons = []
        self.learns.learner.learn = lambda amounts, energy_j: self.lessons.append((amounts, energy_j))

    def go(self, seconds, *, trusted=True, moves=True):
        told = []
        for _ in range(round(seconds / 0.2)):
            if moves:
                self.learns.move(to_ns(self.at_s), 0.5, 0.0)
            told.append(self.learns.draw(Drawn(to_ns(self.at_s), self.energy_j, trusted)))
            self.at_s = round(self.at_s + 0.2, 6)
            self.energy_j += 4.0
        return told


def test_what_is_not_trusted_ends_a_lesson_and_the_next_begins_after_it():
    robot = Robot()
    robot.go(1.6)
    assert robot.go(0.2, trusted=False) == [False]
    assert not any(robot.go(2.0))
    assert robot.go(0.2) == [True]
    assert robot.lessons[0][1] == pytest.approx(40.0)


def test_count_that_begins_anew_begins_a_lesson_anew_and_one_that_stands_still_does_not():
    robot = Robot()
    robot.go(1.6)
    robot.energy_j = 0.0
    assert not any(robot.go(2.0))
    assert robot.go(0.2) == [True]
    still = Robot()
    for number in range(11):
        still.learns.move(to_ns(0.2 * number), 0.5, 0.0)
        is_lesson = still.learns.draw(Drawn(to_ns(0.2 * number), 100.0, True))
    assert is_lesson
    assert still.lessons[0][1] == 0.0


def test_lesson_with_a_hole_and_one_without_motion_samples_is_none():
    robot = Robot()
    robot.go(0.4)
    assert not any(robot.go(4.0, moves=False))
    assert robot.lessons == []
    long = consumption()
    for number in range(40):
        long.move(to_ns(0.2 * number), 0.5, 0.0)
    for end_s, is_lesson in ((LESSON_MAX_S - 0.2, True), (LESSON_MAX_S + 0.2, False)):
        one = consumption()
        one._terms = long._terms
        one.draw(Drawn(0, 0.0, True))
        assert one.draw(Drawn(to_ns(end_s), 100.0, True)) is is_lesson


def test_power_is_averaged_over_seconds_and_over_minutes():
    one = consumption()
    one.draw(Drawn(0, 0.0, True))
    one.draw(Drawn(to_ns(0.5), 9.0, True))
    assert one.power_w == pytest.approx(8.0 + (18.0 - 8.0) * 0.5 / POWER_OVER_S)
    assert one.usual_power_w == pytest.approx(8.0 + (18.0 - 8.0) * 0.5 / USUAL_OVER_S)
    one.draw(Drawn(to_ns(0.5), 50.0, True))  # no time has passed
    before_w = one.power_w
    one.draw(Drawn(to_ns(1.0), 50.0, False))
    one.draw(Drawn(to_ns(1.5), 99.0, True))  # the one before is not trusted
    assert one.power_w == before_w
    one.draw(Drawn(to_ns(1000.0), 99.0 + 30.0 * 998.5, True))
    assert (one.power_w, one.usual_power_w) == pytest.approx((30.0, 30.0))


# -- outcomes ---------------------------------------------------------------------------------------------------

WAY = Work(path_m=20.0)


def test_way_that_cost_more_raises_the_ratio_by_its_share_and_one_that_went_wrong_counts_as_the_most():
    for share, counted in ((0.1, 0.1), (-0.2, -0.2), (5.0, OUTCOME_MOST), (-0.9, -OUTCOME_MOST)):
        one = consumption()
        planned_j = estimate(one.model(0.0), WAY).mean_j
        one.compare(WAY, planned_j * (1.0 + share))
        assert one.model(0.0).path_ratio == pytest.approx(1.0 + counted / (PRIOR_OUTCOMES + 1), abs=1e-4)


def test_waiting_and_packets_are_not_held_against_the_way():
    one = consumption()
    work = Work(path_m=20.0, wait_s=100.0, radio_packets=10_000)
    planned = estimate(one.model(0.0), work)
    way_j = estimate(one.model(0.0), WAY).mean_j
    one.compare(work, planned.mean_j + 0.1 * way_j)
    assert one.model(0.0).path_ratio == pytest.approx(1.0 + 0.1 / 5, abs=1e-4)


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


# -- the learner ------------------------------------------------------------------------------------------------


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


def collected(*batches):
    """The residual after lessons (error in J, duration in s)."""
    learner = PowerLearner(PRIOR)
    for error_j, duration_s in batches:
        learner._collect(error_j, duration_s)
    return learner.residual_w2_s


def test_unexplained_is_collected_over_a_batch_and_its_square_counts_for_each_second():
    assert collected((10.0, BATCH_S - 0.1)) == 4.0
    expected = 4.0 + (12.0**2 / BATCH_S - 4.0) / (PRIOR_BATCHES + 1)
    assert collected((12.0, BATCH_S)) == pytest.approx(expected)
    assert collected((20.0, 15.0), (-8.0, 5.0)) == pytest.approx(expected)
    assert collected((-12.0, BATCH_S), (0.0, 1.0)) == pytest.approx(expected)
    second = expected + (6.0**2 / BATCH_S - expected) / (PRIOR_BATCHES + 2)
    assert collected((12.0, BATCH_S), (6.0, BATCH_S)) == pytest.approx(second)


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


def test_coefficients_are_never_below_nothing():
    learner = PowerLearner(PRIOR)
    for _ in range(50):
        learner.learn((2.0, 2.0, 1.0, 0.0, 0.0), 0.0)
    assert min(learner.coefficients) == 0.0
