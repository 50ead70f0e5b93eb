import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.model.energy_model import (
    EnergyEstimate,
    Work,
    estimate,
)
from tests.energy_models import energy_model

MODEL = energy_model(8.0, 0.5, 10.0, 2.0, 8.0, packet_j=0.001)
AMOUNTS = st.floats(0.0, 1e4)
WORKS = st.builds(Work, AMOUNTS, AMOUNTS, AMOUNTS, st.integers(0, 1000), st.none() | st.floats(0.05, 2.0))


def test_a_wait_costs_what_standing_costs():
    assert estimate(MODEL, Work(wait_s=60.0)) == EnergyEstimate(480.0, 0.0, 60.0)


def test_a_way_costs_its_time_its_length_and_one_start():
    told = estimate(MODEL, Work(path_m=10.0))
    assert told.duration_s == 20.0
    assert told.mean_j == pytest.approx(20.0 * 8.5 + 10.0 * 10.0 + 0.5 * 0.5**2 * 8.0)


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
    told = estimate(unsure, Work(path_m=10.0, wait_s=60.0, radio_packets=1000))
    assert told.sigma_j == pytest.approx(0.1 * way_j)
    assert told.mean_j == pytest.approx(way_j + 480.0 + 1.0)


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
    told = EnergyEstimate(100.0, 60.0, 10.0)
    assert 0.0 <= told.low_j(confidence) <= told.mean_j <= told.high_j(confidence)
    if other > confidence:
        assert told.high_j(other) >= told.high_j(confidence)
    assert told.high_j(0.95) == pytest.approx(100.0 + 1.644854 * 60.0)
