import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.energy.soc_filter import PackModel, SocFilter

PACK = PackModel()


def at_rest(soc: float) -> float:
    return float(np.interp(soc, PACK.curve_soc, PACK.curve_v))


def test_a_first_voltage_tells_the_charge_where_the_curve_is_steep():
    full, flat = SocFilter(PACK), SocFilter(PACK)
    full.start_from(at_rest(1.0) - 0.8 * PACK.resistance_ohm, 0.8)
    flat.start_from(at_rest(0.35) - 0.8 * PACK.resistance_ohm, 0.8)
    assert full.soc == pytest.approx(1.0, abs=0.01)
    assert flat.soc == pytest.approx(0.35, abs=0.01)
    assert full.soc_sd < 0.08 < flat.soc_sd


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
