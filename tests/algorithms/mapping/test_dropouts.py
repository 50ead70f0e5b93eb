"""Beams without a return: single ones say nothing, many side by side say that the way is free."""

import math

import numpy as np
import pytest

from robrain.algorithms.localization.scan_match import without_dropouts

BEAMS = 12


def ranges(*missed, miss_m=6.0):
    ranges_m = np.full(BEAMS, 2.0)
    ranges_m[list(missed)] = miss_m
    return ranges_m


@pytest.mark.parametrize("miss_m", [6.0, 7.5, math.inf, math.nan])
@pytest.mark.parametrize(
    ("missed", "dropped"),
    [
        ((), []),
        ((5,), [5]),
        ((3, 5), [3, 5]),
        ((4, 5, 6), [4, 5, 6]),
        ((4, 5, 6, 7), []),
        ((4, 5, 6, 7, 8), []),
        ((1, 4, 5, 6, 7), [1]),
        ((0, 11), [0, 11]),
        ((0, 1, 10, 11), []),
        (range(BEAMS), []),
    ],
)
def test_fewer_than_four_neighbouring_beams_without_a_return_say_nothing(missed, dropped, miss_m):
    heard_m = without_dropouts(ranges(*missed, miss_m=miss_m), 6.0, 4)
    silent = [beam for beam in range(BEAMS) if math.isnan(heard_m[beam])]
    assert silent == (sorted(missed) if math.isnan(miss_m) else dropped)
