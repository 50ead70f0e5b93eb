"""The filter's results compared with full matrices, or with hand calculations for a pack with a linear curve."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.energy.soc_filter import PackModel, SocFilter

PACK = PackModel()


def at_rest(soc: float) -> float:
    return float(np.interp(soc, PACK.curve_soc, PACK.curve_v))


def test_a_pack_is_taken_for_full_until_something_is_known_of_it():
    one = SocFilter(PACK)
    assert one.soc == 1.0
    one.count(1.0, 600.0)
    assert one.soc == pytest.approx(1.0 - 600.0 / (PACK.health * one.rated_c))


def test_a_charge_that_was_believed_wrongly_is_corrected_by_the_voltage():
    one = SocFilter(PACK)
    one.start_at(0.6, 0.2)
    for _ in range(5 * 300):
        one.count(0.0, 0.2)
        one.fuse(at_rest(0.8), 0.0)
    assert one.soc == pytest.approx(0.8, abs=0.03)


def test_no_number_of_measurements_makes_it_surer_than_the_curve_is():
    one = SocFilter(PACK)
    one.start_at(0.5, 0.3)
    for _ in range(20_000):
        one.fuse(at_rest(0.5), 0.0)
    slope_v = (at_rest(0.6) - at_rest(0.4)) / 0.2
    assert one.soc_sd > 0.9 * PACK.curve_sd_v / slope_v


def test_the_capacity_and_the_resistance_of_an_old_pack_are_found():
    health, resistance_ohm = 0.8, 0.2
    one = SocFilter(PACK)
    one.start_at(1.0, 0.01)
    soc, relaxation_v, stays = 1.0, 0.0, math.exp(-0.2 / PACK.relaxation_s)
    for step in range(40_000):
        current_a = 1.4 if step // 100 % 2 else 0.5
        soc -= current_a * 0.2 / (health * one.rated_c)
        relaxation_v *= stays
        relaxation_v += (1.0 - stays) * current_a * PACK.relaxation_share * resistance_ohm
        if soc < 0.03:
            break
        one.count(current_a, 0.2)
        one.fuse(at_rest(soc) - relaxation_v - current_a * resistance_ohm, current_a)
    assert one.health == pytest.approx(health, abs=0.04)
    assert one.resistance_ohm == pytest.approx(resistance_ohm, abs=0.05)
    assert one.soc == pytest.approx(soc, abs=0.02)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-10.0, 10.0), st.floats(8.0, 17.5), st.floats(0.01, 60.0)), max_size=80),
    st.floats(0.0, 1.0),
)
def test_no_history_of_measurements_breaks_the_filter(history, soc):
    one = SocFilter(PACK)
    one.start_at(soc, 0.1)
    for current_a, voltage_v, duration_s in history:
        one.count(current_a, duration_s)
        one.fuse(voltage_v, current_a)
        assert 0.0 <= one.soc <= 1.0
        mean_j, low_j, high_j = one.interval_j()
        assert 0.0 <= low_j <= mean_j <= high_j < math.inf
        assert np.linalg.eigvalsh(one._covariance).min() > -1e-9


@pytest.mark.parametrize(
    ("pack", "expected"),
    [
        ({"capacity_wh": 0.0}, "expected capacity_wh > 0"),
        ({"health_sd": -1.0}, "expected health_sd >= 0"),
        ({"curve_soc": (0.0, 1.0)}, "expected as many curve_soc as curve_v"),
        ({"curve_soc": (0.0, 1.0), "curve_v": (14.0, 13.0)}, "expected curve_v to rise"),
        ({"curve_soc": (0.0, 1.0), "curve_v": (14.0, 14.0)}, "expected curve_v to rise"),
        ({"curve_soc": (0.0, 0.5, 0.5, 1.0), "curve_v": (12.0, 13.0, 14.0, 15.0)}, "expected curve_soc to rise"),
        ({"curve_soc": (0.0, 0.9), "curve_v": (13.0, 14.0)}, "expected curve_soc from 0 to 1"),
        ({"curve_soc": (0.1, 1.0), "curve_v": (13.0, 14.0)}, "expected curve_soc from 0 to 1"),
        ({"curve_soc": (0.0,), "curve_v": (13.0,)}, "two at least"),
        ({"cut_off_v": PACK.curve_v[-1]}, "expected cut_off_v below the curve's end"),
        ({"cut_off_v": 20.0}, "expected cut_off_v below the curve's end"),
    ],
)
def test_an_impossible_datasheet_is_refused(pack, expected):
    with pytest.raises(ValueError, match=expected):
        PackModel(**pack)


CERTAIN = {
    "curve_sd_v": 0.0,
    "resistance_ohm": 1e-12,
    "resistance_sd": 0.0,
    "relaxation_share": 0.0,
    "health": 0.5,
    "health_sd": 0.0,
    "missed_sd": 0.0,
    "drive_current_a": 2.0,
    "rate_loss_s": 0.0,
}
"""A half-charged pack of which everything is known."""
RATED_C, HEALTH = 3600.0, 0.5


def straight(**changes: float) -> SocFilter:
    """Linear curve from 12 V (cut-off) to 16 V, 3600 C rated; half charged it has 14 V, and 13 V on average below."""
    pack = PackModel(
        capacity_wh=14.0, curve_soc=(0.0, 0.5, 1.0), curve_v=(12.0, 14.0, 16.0), cut_off_v=12.0, **(CERTAIN | changes)
    )
    one = SocFilter(pack)
    one.start_at(0.5, 0.0)
    return one


def with_covariance(one: SocFilter, entries: dict[tuple[int, int], float]) -> SocFilter:
    """The same with these entries of the covariance, which is symmetric."""
    state, covariance = one.snapshot()
    for (row, column), value in entries.items():
        covariance[row, column] = covariance[column, row] = value
    one.restore((state, covariance))
    return one


@pytest.mark.parametrize(("soc", "area_v"), [(0.25, 3.125), (0.5, 6.5), (0.75, 10.125), (1.0, 14.0)])
def test_the_area_is_counted_over_all_pieces_of_the_curve(soc, area_v):
    one = straight()
    one.start_at(soc, 0.0)
    assert one.remaining_j()[0] == pytest.approx(RATED_C * HEALTH * area_v)


def test_a_load_leaves_charge_behind_at_the_end():
    # 90 s of 2 A are a tenth of 1800 C; below it lies an area of 1.22 V.
    mean_j, sd_j = straight(rate_loss_s=90.0).remaining_j()
    assert mean_j == pytest.approx(RATED_C * HEALTH * (6.5 - 1.22))
    # The standard deviation is half of the remaining charge.
    assert sd_j == pytest.approx(RATED_C * HEALTH * 14.0 * 0.05)


def test_the_cut_off_comes_sooner_by_what_the_load_drops_at_the_resistance():
    # 2 A over 0.25 Ω, and half as much again over the RC pair, drop 0.75 V: the cut-off is reached at 12.75 V.
    mean_j, sd_j = straight(resistance_ohm=0.25, relaxation_share=0.5).remaining_j()
    empty, drop_v = 0.75 / 4.0, 0.75
    area_v = 12.0 * (0.5 - empty) + 2.0 * (0.25 - empty**2)
    assert mean_j == pytest.approx(RATED_C * HEALTH * (area_v - drop_v * (0.5 - empty)))
    assert sd_j == pytest.approx(0.0, abs=1e-6)


def test_charge_and_drop_that_are_unsure_count_between_the_end_and_here_at_what_is_left_under_the_load():
    # The load drops 0.5 V, so that the pack is empty at an eighth.
    one = with_covariance(straight(resistance_ohm=0.25, missed_sd=0.02), {(3, 3): 0.1**2})
    drop_sd_v = 2.0 * 0.1
    by_charge_j = RATED_C * HEALTH * (14.0 - 0.5) * 0.02
    by_end_j = RATED_C * HEALTH * (14.0 - 0.5) * drop_sd_v / 4.0
    by_drop_j = RATED_C * HEALTH * (0.5 - 0.125) * drop_sd_v
    assert one.remaining_j()[1] == pytest.approx(math.hypot(by_charge_j, by_end_j, by_drop_j))


def test_a_pack_below_its_end_has_nothing_left_and_no_less_than_nothing():
    one = straight(rate_loss_s=1800.0)  # it would be empty at twice the charge
    assert one.remaining_j()[0] == 0.0
    assert one.interval_j()[1] == 0.0


def test_a_first_voltage_is_taken_without_what_the_load_drops():
    one = straight(resistance_ohm=0.25, relaxation_share=0.5, curve_sd_v=0.08)
    one.start_from(13.5, 2.0)
    assert one.soc == pytest.approx(0.5)
    # Of the curve, of one measurement, and of not knowing how far it has relaxed, over 4 V.
    assert one.soc_sd == pytest.approx(math.sqrt(0.08**2 + 0.02**2 + (2.0 * 0.25 * 1.5) ** 2) / 4.0)


STATE = (0.45, 0.05, 0.01, 0.15, 0.9)


def somewhere() -> SocFilter:
    """A filter in mid-run: all errors are correlated."""
    one = SocFilter(PACK)
    root = np.random.default_rng(7).normal(size=(5, 5)) * 0.02
    one.restore((np.array(STATE), root @ root.T + 1e-4 * np.eye(5)))
    return one


@pytest.mark.parametrize(("current_a", "duration_s"), [(1.4, 30.0), (-2.0, 10.0), (0.0, 60.0)])
def test_counting_predicts_the_state_and_its_covariance(current_a, duration_s):
    one = somewhere()
    x, p = one.snapshot()
    one.count(current_a, duration_s)
    soc, relaxation_v, wrong_v, resistance_ohm, health = x
    moved = current_a * duration_s / (health * one.rated_c)
    stays, steady = math.exp(-duration_s / PACK.relaxation_s), math.exp(-duration_s / PACK.curve_wander_s)
    flows = (1.0 - stays) * current_a * PACK.relaxation_share
    f = np.diag([1.0, stays, steady, 1.0, 1.0])
    f[0, 4], f[1, 3] = moved / health, flows
    q = np.diag(
        [
            PACK.current_sd**2 * abs(moved),
            (0.1 * current_a * PACK.relaxation_share * resistance_ohm) ** 2 * (1.0 - stays**2),
            PACK.curve_sd_v**2 * (1.0 - steady**2),
            (0.1 * PACK.resistance_ohm) ** 2 * duration_s / 3600.0,
            0.0,
        ]
    )
    state, covariance = one.snapshot()
    expected = (soc - moved, stays * relaxation_v + flows * resistance_ohm, steady * wrong_v, resistance_ohm, health)
    assert state == pytest.approx(np.array(expected), rel=1e-9)
    assert covariance == pytest.approx(f @ p @ f.T + q, rel=1e-9)
    assert (one.health, one.resistance_ohm) == (0.9, 0.15)


@pytest.mark.parametrize("current_a", [1.4, -2.0, 0.0])
def test_a_voltage_corrects_the_state_and_its_covariance(current_a):
    one = somewhere()
    x, p = one.snapshot()
    expected_v = one.expected_v(current_a)
    one.fuse(expected_v + 0.02, current_a)
    slope_v = (15.2 - 15.08) / 0.1
    h = np.array([slope_v, -1.0, 1.0, -current_a, 0.0])
    spread = h @ p @ h + PACK.voltage_sd_v**2
    gain = p @ h / spread
    state, covariance = one.snapshot()
    assert state == pytest.approx(x + gain * 0.02, rel=1e-9)
    assert covariance == pytest.approx(p - np.outer(gain, gain) * spread, rel=1e-9)


@pytest.mark.parametrize(("current_a", "soc"), [(100.0, 0.0), (-100.0, 1.02)])
def test_no_count_leaves_the_pack(current_a, soc):
    one = somewhere()
    one.count(current_a, 3600.0)
    assert one.snapshot()[0][0] == soc
