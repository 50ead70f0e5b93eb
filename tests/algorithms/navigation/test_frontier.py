import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from robrain.algorithms.navigation import frontier as frontier_module
from robrain.algorithms.navigation.frontier import Frontier, find_frontiers, frontier_mask, touching, unknown_beyond
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN


def room(height: int = 20, width: int = 60) -> np.ndarray:
    """A free floor on the left, the unknown on the right of column 9."""
    classes = np.full((height, width), UNKNOWN)
    classes[:, :10] = FREE
    return classes


def test_border_of_known_floor_is_a_frontier_named_by_its_middle() -> None:
    assert find_frontiers(room()) == [Frontier(row=9, column=9, cells=20)]


def test_long_frontier_is_shared_out_in_even_pieces() -> None:
    frontiers = find_frontiers(room(height=90))
    assert sorted(frontier.cells for frontier in frontiers) == [30, 30, 30]
    assert sorted(frontier.row for frontier in frontiers) == pytest.approx([15, 45, 75], abs=1)


def test_ring_is_split_so_that_no_piece_spans_it() -> None:
    rows, columns = np.mgrid[:80, :80]
    classes = np.where(np.hypot(rows - 40, columns - 40) < 30, FREE, UNKNOWN)
    frontiers = find_frontiers(classes)
    assert sum(frontier.cells for frontier in frontiers) == np.count_nonzero(frontier_mask(classes))
    assert len(frontiers) >= 4
    assert all(frontier.cells < 60 for frontier in frontiers)


@settings(deadline=None)
@given(arrays(np.int8, (14, 17), elements=st.sampled_from([-1, 0, 100])), st.integers(1, 12))
def test_every_frontier_cell_is_in_one_piece_and_every_piece_is_named_by_one_of_its_cells(
    classes: np.ndarray, split_cells: int
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frontier_module, "SPLIT_CELLS", split_cells)
        frontiers = find_frontiers(classes, min_cells=1)
    mask = frontier_mask(classes)
    assert sum(frontier.cells for frontier in frontiers) == np.count_nonzero(mask)
    assert all(mask[frontier.row, frontier.column] for frontier in frontiers)
    assert frontiers == sorted(frontiers, key=lambda frontier: (-frontier.cells, frontier.row, frontier.column))
    assert len({(frontier.row, frontier.column) for frontier in frontiers}) == len(frontiers)


def test_unknown_floor_beyond_a_frontier_counts_as_far_as_its_reach() -> None:
    assert unknown_beyond(room(), 10, 9, 4) == 4 * 9
    assert unknown_beyond(room(), 0, 9, 4) == 4 * 5, "beyond the map is nothing"
    assert unknown_beyond(room(), 10, 9, 100) == 50 * 20


def test_unknown_floor_behind_a_wall_is_not_beyond_a_frontier() -> None:
    classes = room()
    classes[:, 12] = OCCUPIED
    assert unknown_beyond(classes, 10, 9, 4) == 2 * 9
    classes[14, 12] = UNKNOWN
    assert unknown_beyond(classes, 10, 9, 4) == 2 * 9 + 9 + 1, "a door leads there"


@given(arrays(np.bool_, st.tuples(st.integers(0, 12), st.integers(0, 12))), st.booleans())
def test_groups_of_cells_that_touch_are_numbered_as_scipy_numbers_them(cells: np.ndarray, corners: bool) -> None:
    labels, groups = touching(cells, corners=corners)
    expected, count = ndimage.label(cells, structure=np.ones((3, 3)) if corners else None)
    assert groups == count
    assert np.array_equal(labels, expected)
