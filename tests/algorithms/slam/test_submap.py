"""What a submap makes of what mates tell of it: borders of its cells, its surfaces, and its times."""

import numpy as np
import pytest

from robrain.algorithms.slam.submap import SURFACE, Submap
from robrain.protocol.model.grid_geometry import FREE, GridGeometry

TEAM = GridGeometry(0.1, -3.0, 2.0, 200, 100)


def surfaces_in(*cells: tuple[int, int]) -> np.ndarray:
    """A surface in the middle of each of these cells of the team's grid."""
    surfaces = np.zeros(len(cells), SURFACE)
    for surface, (row, column) in zip(surfaces, cells, strict=True):
        surface["row"], surface["column"] = row, column
    return surfaces


@pytest.mark.parametrize("beside", [(-1, 0), (32, 0), (0, -1), (0, 64), (-1, -1), (32, 64), (900, 0), (0, -900)])
def test_surfaces_that_a_mate_tells_beside_the_cells_of_its_submap_are_left_out(beside: tuple[int, int]) -> None:
    submap = Submap()
    submap.merge(32, 64, np.full((32, 64), FREE, np.int8), 1)
    corners = [(32, 64), (32, 127), (63, 64), (63, 127)]
    submap.surfaces = surfaces_in(*corners, (32 + beside[0], 64 + beside[1]))
    grid = submap.grid(TEAM)
    assert grid.geometry.shape == (32, 64)
    assert np.argwhere(grid.surfaces.hits).tolist() == [[0, 0], [0, 63], [31, 0], [31, 63]]
    for row, column in ((0, 0), (31, 63)):
        assert grid.surfaces.at[row, column].tolist() == [column + 0.5, row + 0.5]


@pytest.mark.parametrize(("rows", "columns"), [(4096, 1), (1, 4096)])
def test_a_submap_of_the_largest_side_is_taken_and_none_larger(rows: int, columns: int) -> None:
    cells = np.full((rows, columns), FREE, np.int8)
    submap = Submap()
    submap.merge(0, 0, cells, 1)
    assert max(submap.evidence.shape) == 4096
    for row, column in ((-1, 0), (0, -1), (rows, 0), (0, columns)):
        if (row < 0 or row == rows) == (rows > 1):
            with pytest.raises(ValueError, match="at most 4096 cells a side"):
                submap.merge(row, column, np.full((1, 1), FREE, np.int8), 2)
    assert submap.growth(0, 0, (1, 1), 2) == 0
