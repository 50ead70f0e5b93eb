import pytest

from robrain.algorithms.localization.rssi_ranging import NEAREST_M, PathLoss


@pytest.mark.parametrize("distance_m", [0.1, 0.5, 1.0, 7.0, 40.0])
def test_the_range_of_the_expected_strength_is_the_distance(distance_m):
    loss = PathLoss(rssi_at_1_m_dbm=-55.0, exponent=2.4)
    assert loss.range_m(loss.mean_dbm(distance_m)) == pytest.approx(distance_m)


def test_ten_times_the_distance_costs_ten_times_the_exponent():
    loss = PathLoss(rssi_at_1_m_dbm=-55.0, exponent=2.4)
    assert loss.mean_dbm(1.0) == -55.0
    assert loss.mean_dbm(10.0) == pytest.approx(-79.0)
    assert loss.mean_dbm(0.0) == loss.mean_dbm(NEAREST_M) == pytest.approx(-31.0)
