"""Distances and durations in the solver's units, filled in one pass: at 1,000 visits they are most of its start."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.coordinator.allocation.arrays import Floats, Indices

ROUNDING = 1e-6
"""Units by which a float may lie above an integer and still be meant to be it."""


@njit(cache=True, nogil=True)
def fill_matrix(
    ways: Floats,
    places: Indices,
    allowed: NDArray[np.bool_],
    service: Floats,
    ends: Floats,
    scale: float,
    forbidden: int,
    is_up: bool,
) -> NDArray[np.int64]:
    """One matrix of a profile.

    Args:
        ways: (n, n) joules or seconds between places.
        places: (m,) of the visits and then of the starts.
        allowed: (visits,) to which of them there is a way for this kind of worker.
        service: (visits,) what each visit adds to every way to it.
        ends: (m, e) from each of them to each end.
        scale: units for one joule or second.
        forbidden: what stands where there is no way.
        is_up: rounds up; down otherwise.

    Returns:
        (m + e, m + e); rows of the ends and columns of the starts are 0, since nobody goes there.

    """
    count, end_count = ends.shape
    visits = len(allowed)
    matrix = np.zeros((count + end_count, count + end_count), np.int64)
    for row in range(count):
        here = places[row]
        for column in range(visits):
            if row != column:
                length = ways[here, places[column]] + service[column] if allowed[column] else math.inf
                matrix[row, column] = _units(length, scale, forbidden, is_up)
        for column in range(end_count):
            matrix[row, count + column] = _units(ends[row, column], scale, forbidden, is_up)
    return matrix


@njit(cache=True, nogil=True)
def _units(length: float, scale: float, forbidden: int, is_up: bool) -> int:
    if not length < math.inf:
        return forbidden
    return math.ceil(length * scale - ROUNDING) if is_up else math.floor(length * scale)


def greatest(ways: Floats) -> float:
    """The longest way that there is; 0 if there is none."""
    most = float(np.max(ways)) if ways.size else 0.0
    return most if math.isfinite(most) else float(np.max(ways, where=np.isfinite(ways), initial=0.0))
