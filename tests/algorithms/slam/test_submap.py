"""What a submap makes of what mates tell of it: borders of its cells, its surfaces, and its times."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.slam.submap import PARTS, SURFACE, Submap
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.map_frame import ARENA, MapFrame

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


def test_a_surface_lies_in_its_cell_where_it_was_told_and_was_seen_from_there() -> None:
    submap = Submap()
    submap.merge(0, 0, np.full((32, 32), OCCUPIED, np.int8), 1)
    submap.surfaces = surfaces_in((3, 7))
    submap.surfaces["right"], submap.surfaces["up"], submap.surfaces["view"] = PARTS // 4, -PARTS // 2, 64
    grid = submap.grid(TEAM)
    assert grid.surfaces.at[3, 7].tolist() == [7.75, 3.0]
    assert grid.surfaces.seen_along[3, 7] == pytest.approx((0.0, 1.0), abs=1e-7)
    assert (grid.geometry.origin_x_m, grid.geometry.origin_y_m) == (TEAM.origin_x_m, TEAM.origin_y_m)


@settings(deadline=None, max_examples=60)
@given(
    st.lists(
        st.tuples(
            st.integers(-20, 40), st.integers(-20, 40), st.integers(1, 12), st.integers(1, 12), st.integers(1, 9)
        ),
        min_size=1,
        max_size=4,
    ),
    st.tuples(st.integers(-90, 90), st.integers(-90, 90), st.integers(1, 20), st.integers(1, 20)),
)
def test_a_patch_is_newest_when_it_is_later_than_all_tiles_that_it_touches(
    told: list[tuple[int, int, int, int, int]], box: tuple[int, int, int, int]
) -> None:
    submap, latest = Submap(), {}
    for row, column, height, width, stamp_ms in told:
        submap.merge(row, column, np.full((height, width), FREE, np.int8), stamp_ms)
        for i in range(row, row + height):
            for j in range(column, column + width):
                tile = i // 8, j // 8
                latest[tile] = max(latest.get(tile, 0), stamp_ms)
    first_row, first_column, end_row, end_column = submap.box
    row, column, height, width = box
    tiles = {(i // 8, j // 8) for i in range(row, row + height) for j in range(column, column + width)}
    inside = [
        latest.get((i, j), 0) for i, j in tiles if first_row <= 8 * i < end_row and first_column <= 8 * j < end_column
    ]
    cells, last_ms = np.full((height, width), FREE, np.int8), max(inside, default=-1)
    assert submap.after(row, column, cells, last_ms + 1).is_newest
    assert submap.after(row, column, cells, max(last_ms, 0)).is_newest == (last_ms < 0)


def test_a_step_leaves_the_submap_that_it_was_computed_from_as_it_was() -> None:
    submap, cells = Submap(), np.full((3, 3), OCCUPIED, np.int8)
    submap.merge(0, 0, np.full((3, 3), FREE, np.int8), 1)
    step = submap.after(0, 0, cells, 2)
    assert (submap.evidence[:3, :3] < 0).all()
    assert submap.stamp_ms[0, 0] == 1
    assert submap.occupied == 0
    submap.become(step)
    assert (submap.evidence[:3, :3] > 0).all()
    assert submap.stamp_ms[0, 0] == 2
    assert submap.occupied == 9


@pytest.mark.parametrize(("row", "column"), [(5, 9), (-3, -40), (31, 32), (32, 31)])
def test_a_submap_covers_what_it_was_told_in_whole_blocks_and_no_more(row: int, column: int) -> None:
    submap = Submap()
    submap.merge(row, column, np.full((1, 1), OCCUPIED, np.int8), 3)
    first_row, first_column, end_row, end_column = submap.box
    assert (first_row, first_column) == (row // 32 * 32, column // 32 * 32)
    assert (end_row, end_column) == (first_row + 32, first_column + 32)
    classes = submap.classes()
    assert np.argwhere(classes != UNKNOWN).tolist() == [[row - first_row, column - first_column]]
    assert submap.occupied == 1
    submap.merge(row, column, np.full((1, 1), FREE, np.int8), 4)
    assert submap.occupied == 0


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


CORNERS = [(0, 0), (0, 192), (92, 0), (92, 192), (40, 100)]


@pytest.mark.parametrize("there", CORNERS)
@pytest.mark.parametrize("here", CORNERS)
def test_in_whatever_corner_of_the_map_a_submap_lies_it_is_drawn_moved_and_erased(
    here: tuple[int, int], there: tuple[int, int]
) -> None:
    atlas = SubmapAtlas(TEAM)
    atlas.merge(("r2", 7), *here, np.full((8, 8), OCCUPIED, np.int8), 1)
    for up, right in ((0, 0), (there[0] - here[0], there[1] - here[1]), (0, 0)):
        atlas.move(("r2", 7), Pose2D(0.1 * right, 0.1 * up, 0.0))
        cells = np.argwhere(atlas.grid.log_odds > 0)
        assert cells.min(axis=0).tolist() == [here[0] + up, here[1] + right]
        assert len(cells) == atlas.grid.known_count == 64
    atlas.change_frame(MapFrame(20, "r1"))
    assert atlas.grid.known_count == 0
    atlas.change_frame(ARENA)
    assert atlas.grid.known_count == 64
    atlas.withdraw(("r2", 7))
    assert atlas.grid.known_count == 0
    assert not atlas.grid.log_odds.any()
