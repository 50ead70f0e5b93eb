"""Whether a straight line between two places touches only cells that may be driven on."""

import math

import numpy as np
import pytest

from robrain.algorithms.navigation.path_planning import is_chord_clear

OPEN = np.ones((6, 8), np.bool_)


def blocked(*cells: tuple[int, int]) -> np.ndarray:
    mask = OPEN.copy()
    for cell in cells:
        mask[cell] = False
    return mask


def plainly_clear(mask: np.ndarray, begin: np.ndarray, end: np.ndarray) -> bool:
    steps = math.floor(10.0 * math.dist(begin, end)) + 1
    for k in range(steps + 1):
        row, column = np.floor(begin + k / steps * (end - begin) + 0.5).astype(int)
        if not (row in range(mask.shape[0]) and column in range(mask.shape[1]) and mask[row, column]):
            return False
    return True


def test_line_is_clear_if_each_sample_of_it_is_for_any_cells() -> None:
    draw = np.random.default_rng(4)
    seen = []
    for _ in range(600):
        mask = draw.random(OPEN.shape) < 0.9
        begin = draw.uniform((-0.4, -0.4), (5.4, 7.4))
        end = begin + draw.normal(0.0, 1.2, 2)
        seen.append(is_chord_clear(mask, *begin, *end))
        assert seen[-1] == plainly_clear(mask, begin, end)
    assert 150 < sum(seen) < 450


@pytest.mark.parametrize(("row", "column"), [(2.0, 3.52), (2.0, 1.48), (2.52, 2.5), (1.48, 2.5)])
def test_line_that_begins_or_ends_just_inside_a_blocked_cell_is_not_clear(row: float, column: float) -> None:
    mask = blocked(*[(cell_row, cell_column) for cell_row in (1, 3) for cell_column in range(8)], (2, 1), (2, 4))
    assert is_chord_clear(mask, 2.0, 2.0, 2.0, 3.0)
    assert not is_chord_clear(mask, 2.0, 2.5, row, column)
    assert not is_chord_clear(mask, row, column, 2.0, 2.5)


def test_corner_is_seen_if_more_than_a_tenth_of_a_cell_of_it_is_cut() -> None:
    mask = blocked((1, 0))
    assert is_chord_clear(mask, 0.48, 0.46, 0.53, 0.51)  # 0.07 long: only its ends are looked at
    assert not is_chord_clear(mask, 0.4, 0.2, 0.8, 0.6)
