"""Means, intervals and paired tests, compared with published values and with scipy."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from robrain.lab.report.mean_interval import holm, mean_interval, paired_difference

NUMBERS = st.lists(st.integers(-1000, 1000).map(float), min_size=2, max_size=30)


@pytest.mark.slow
@settings(max_examples=30)
@given(NUMBERS)
def test_the_interval_is_within_the_values(values: list[float]) -> None:
    found = mean_interval(values)
    assert found is not None
    assert found.low is not None
    assert found.high is not None
    assert min(values) <= found.low <= found.mean <= found.high <= max(values)
    assert (found.width > 0) == (len(set(values)) > 1)
    assert found == mean_interval(values)


def test_the_interval_of_many_values_is_nearly_that_of_student() -> None:
    values = [float(value) for value in stats.norm.rvs(100.0, 10.0, size=60, random_state=3)]
    found = mean_interval(values)
    low, high = stats.t.interval(0.95, 59, loc=stats.tmean(values), scale=stats.sem(values))
    assert found is not None
    assert (found.low, found.high) == (pytest.approx(low, abs=0.4), pytest.approx(high, abs=0.4))


def test_one_value_has_no_interval_and_none_no_mean() -> None:
    one = mean_interval([4.0])
    assert one is not None
    assert (one.mean, one.low, one.high, one.width, one.n) == (4.0, None, None, 0.0, 1)
    assert one.words(1, scale=10.0, sign="+") == "+40.0"
    assert mean_interval([]) is None


@pytest.mark.slow
@settings(max_examples=30)
@given(NUMBERS)
def test_the_paired_test_is_that_of_student(differences: list[float]) -> None:
    first = dict.fromkeys(range(len(differences)), 100.0)
    found = paired_difference(first, {seed: 100.0 + each for seed, each in enumerate(differences)})
    assert found is not None
    assert found.p is not None
    if len(set(differences)) > 1:
        assert found.p == pytest.approx(stats.ttest_1samp(differences, 0.0).pvalue)
    else:
        assert found.p == (1.0 if differences[0] == 0 else 0.0)


def test_pairs_are_made_by_seed() -> None:
    found = paired_difference({1: 10.0, 2: 20.0, 3: 30.0}, {3: 33.0, 2: 20.0, 9: 1.0})
    assert found is not None
    assert (found.difference.mean, found.difference.n) == (1.5, 2)
    assert (found.share_lower, found.share_higher) == (0.0, 0.5)
    assert paired_difference({1: 1.0}, {2: 1.0}) is None
    one = paired_difference({1: 10.0}, {1: 12.0})
    assert one is not None
    assert (one.difference.mean, one.p) == (2.0, None)


def test_holm_corrects_as_in_his_example() -> None:
    assert holm([0.01, 0.02, 0.03, 0.04]) == pytest.approx([0.04, 0.06, 0.06, 0.06])
    assert holm([0.5, 0.6]) == [1.0, 1.0]
    assert holm([]) == []
