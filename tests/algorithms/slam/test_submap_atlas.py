import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.slam import submap_atlas
from robrain.algorithms.slam.submap import BLOCK_CELLS, SURFACE, TILE_CELLS, Submap, moved_box
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

GEOMETRY = GridGeometry(0.5, -3.0, 2.0, 24, 20)
ROBOTS = ("r1", "r2", "r3")
CLASS = st.sampled_from([FREE, OCCUPIED, UNKNOWN])
PLACE = st.one_of(
    st.just(IDENTITY),
    st.builds(lambda right, up: Pose2D(0.5 * right, 0.5 * up, 0.0), st.integers(-8, 8), st.integers(-8, 8)),
    st.builds(Pose2D, st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(-3.1, 3.1)),
)
ONE = np.array([[OCCUPIED]])


@st.composite
def boxes(draw):
    """Row, column and cells."""
    shape = draw(st.integers(1, 12)), draw(st.integers(1, 12))
    return draw(st.integers(-20, 30)), draw(st.integers(-20, 30)), draw(arrays(np.int8, shape, elements=CLASS))


@st.composite
def histories(draw):
    """What each robot says one after the other, of its submaps 0 and 1: cells, places, withdrawals."""
    said = {}
    for robot in ROBOTS:
        kinds = draw(st.lists(st.sampled_from(["take", "take", "move", "withdraw"]), max_size=5))
        said[robot] = [(kind, (robot, draw(st.integers(0, 1))), draw(boxes()), draw(PLACE)) for kind in kinds]
    return said


def tell(atlas, number, statement):
    """`number` grows with what a robot says; several robots may have seen things at the same time."""
    kind, key, (row, column, cells), place = statement
    if kind == "take":
        atlas.merge(key, row, column, cells, 100 + 10 * number)
    elif kind == "move":
        atlas.move(key, place)
    else:
        atlas.withdraw(key)


def told(history, order):
    atlas, next_of = SubmapAtlas(GEOMETRY), dict.fromkeys(ROBOTS, 0)
    for robot in order:
        tell(atlas, next_of[robot], history[robot][next_of[robot]])
        next_of[robot] += 1
    return atlas


def composed(atlas):
    """The rule, cell by cell: what was seen last counts, of what was seen at the same time a wall."""
    classes = np.full(GEOMETRY.shape, UNKNOWN)
    for i in range(GEOMETRY.height):
        for j in range(GEOMETRY.width):
            said = []
            for submap in atlas.submaps.values():
                middle = GEOMETRY.center_of(i, j)
                place = submap.T_arena_local.inverse().compose(Pose2D(middle.x_m, middle.y_m, 0.0))
                row, column = GEOMETRY.cell_of(place.x_m, place.y_m)
                row, column = row - submap.row, column - submap.column
                height, width = submap.evidence.shape
                if 0 <= row < height and 0 <= column < width and submap.evidence[row, column]:
                    said.append(
                        (submap.stamp_ms[row // TILE_CELLS, column // TILE_CELLS], submap.evidence[row, column])
                    )
            if said:
                classes[i, j] = OCCUPIED if max(said)[1] > 0 else FREE
    return classes


@settings(deadline=None, max_examples=20)
@given(histories(), st.randoms(use_true_random=False))
def test_in_whatever_order_robots_are_heard_the_map_is_the_same(history, random):
    order = [robot for robot in ROBOTS for _ in history[robot]]
    one = told(history, order)
    random.shuffle(order)
    other = told(history, order)
    assert np.array_equal(one.grid.classes(), other.grid.classes())
    assert np.array_equal(one.grid.stamp_ms, other.grid.stamp_ms)


@settings(deadline=None, max_examples=20)
@given(histories(), st.randoms(use_true_random=False))
def test_the_map_is_what_the_rule_says_of_all_submaps_where_they_lie(history, random):
    order = [robot for robot in ROBOTS for _ in history[robot]]
    random.shuffle(order)
    atlas = told(history, order)
    assert np.array_equal(atlas.grid.classes(), composed(atlas))
    assert atlas.grid.known_count == np.count_nonzero(atlas.grid.classes() != UNKNOWN)


def test_no_more_submaps_are_held_than_fit(monkeypatch):
    monkeypatch.setattr(submap_atlas, "SUBMAPS_MAX", 2)
    atlas = SubmapAtlas(GEOMETRY)
    for number in (0, 1):
        atlas.merge(("r1", number), number, 0, ONE, 5)
    for number in (2, 3, 4):
        atlas.move(("r2", number), Pose2D(1.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="at most 2 submaps"):
        atlas.merge(("r1", 2), 2, 0, ONE, 5)
    assert atlas.grid.known_count == 2
    assert atlas.merge(("r1", 1), 2, 0, ONE, 5) == 1
    atlas.withdraw(("r1", 0))
    atlas.withdraw(("r1", 1))
    atlas.merge(("r2", 2), 2, 0, ONE, 5)
    assert atlas.grid.classes()[2, 0] == OCCUPIED, "its place was told before those of two others"
    atlas.merge(("r2", 4), 4, 0, ONE, 5)
    assert atlas.grid.classes()[4, 2] == OCCUPIED, "the latest places are kept"


def test_no_more_cells_are_held_than_fit_and_those_of_withdrawn_submaps_are_given_back(monkeypatch):
    monkeypatch.setattr(submap_atlas, "CELLS_MAX", 2 * BLOCK_CELLS**2)
    atlas = SubmapAtlas(GEOMETRY)
    full = np.full((BLOCK_CELLS, BLOCK_CELLS), FREE)
    atlas.merge(("r1", 0), 0, 0, full, 5)
    atlas.merge(("r1", 1), 0, 0, full, 6)
    with pytest.raises(ValueError, match=f"at most {2 * BLOCK_CELLS**2} bytes"):
        atlas.merge(("r1", 2), 0, 0, full, 7)
    assert set(atlas.submaps) == {("r1", 0), ("r1", 1)}
    atlas.withdraw(("r1", 0))
    atlas.merge(("r1", 2), 0, 0, full, 7)
    assert set(atlas.submaps) == {("r1", 1), ("r1", 2)}


def test_surfaces_count_with_the_cells(monkeypatch):
    surfaces = np.zeros(50, SURFACE)
    monkeypatch.setattr(submap_atlas, "CELLS_MAX", 2 * BLOCK_CELLS**2 + surfaces.nbytes)
    atlas = SubmapAtlas(GEOMETRY)
    for number in (0, 1):
        atlas.merge(("r1", number), 0, 0, ONE, 5)
    atlas.set_surfaces(("r1", 0), surfaces)
    atlas.set_surfaces(("r1", 0), surfaces)  # again, in place of the first ones
    with pytest.raises(ValueError, match="at most 2598 bytes in all"):
        atlas.set_surfaces(("r1", 1), surfaces[:1])
    assert atlas.submaps["r1", 1].surfaces is None
    atlas.withdraw(("r1", 0))
    atlas.set_surfaces(("r1", 1), surfaces)


def test_a_submap_does_not_grow_beyond_the_room_there_is(monkeypatch):
    """A single cell far away would make its box larger than all that an atlas holds."""
    monkeypatch.setattr(submap_atlas, "CELLS_MAX", 4 * BLOCK_CELLS**2)
    atlas = SubmapAtlas(GEOMETRY)
    atlas.merge(("r1", 0), 0, 0, ONE, 5)
    with pytest.raises(ValueError, match="at most 4096 bytes in all"):
        atlas.merge(("r1", 0), 3000, 3000, ONE, 6)
    assert atlas.submaps["r1", 0].evidence.size == BLOCK_CELLS**2
    atlas.merge(("r1", 0), BLOCK_CELLS, BLOCK_CELLS, ONE, 6)
    assert atlas.submaps["r1", 0].evidence.size == 4 * BLOCK_CELLS**2


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(boxes(), boxes())
def test_a_submap_holds_what_it_was_told_last(first, second):
    submap, everywhere = Submap(), np.full((80, 80), UNKNOWN)
    for stamp_ms, (row, column, cells) in enumerate((first, second), 1):
        submap.merge(row, column, cells, stamp_ms)
        box = everywhere[20 + row : 20 + row + cells.shape[0], 20 + column : 20 + column + cells.shape[1]]
        box[cells != UNKNOWN] = cells[cells != UNKNOWN]
    known = np.full((160, 160), UNKNOWN)
    height, width = submap.evidence.shape
    known[44 + submap.row : 44 + submap.row + height, 44 + submap.column : 44 + submap.column + width] = (
        submap.classes()
    )
    assert np.array_equal(known[24:104, 24:104], everywhere)
    assert submap.occupied == np.count_nonzero(everywhere == OCCUPIED)
    assert submap.version == 2
    assert (submap.row % BLOCK_CELLS, submap.column % BLOCK_CELLS) == (0, 0)


def test_the_times_of_a_submap_are_those_of_its_tiles():
    submap = Submap()
    submap.merge(0, 0, np.full((1, 9), FREE), 7)
    submap.merge(0, 0, ONE, 5)
    assert submap.stamp_ms[0].tolist() == [7, 7, 0, 0]
    submap.merge(0, 0, np.full((16, 8), FREE), np.array([[6], [8]], np.int32))
    assert submap.stamp_ms[:, 0].tolist() == [7, 8, 0, 0]
    submap.merge(-1, 0, ONE, 9)  # the box grows downwards
    assert submap.stamp_ms[:, 0].tolist() == [0, 0, 0, 9, 7, 8, 0, 0]


@given(boxes(), PLACE)
def test_a_moved_box_holds_the_cells_of_the_box(box, place):
    row, column, cells = box
    grid = (GEOMETRY.resolution_m, GEOMETRY.origin_x_m, GEOMETRY.origin_y_m)
    height, width = cells.shape
    first_row, first_column, end_row, end_column = moved_box(place, (row, column, row + height, column + width), grid)
    for i in (0, height - 1):
        for j in (0, width - 1):
            middle = GEOMETRY.center_of(row + i, column + j)
            moved = place.compose(Pose2D(middle.x_m, middle.y_m, 0.0))
            at_row, at_column = GEOMETRY.cell_of(moved.x_m, moved.y_m)
            assert first_row <= at_row < end_row
            assert first_column <= at_column < end_column
    assert (end_row - first_row) <= height + width + 2


def test_patches_that_change_nothing_on_the_map_leave_its_version():
    atlas = SubmapAtlas(GridGeometry(0.1, 0.0, 0.0, 40, 40))
    cells = np.full((4, 4), OCCUPIED, np.int8)
    assert atlas.merge(("r1", 1), 8, 8, cells, 5) == 16
    version = atlas.grid.version
    assert atlas.merge(("r1", 1), 8, 8, cells, 5) == 0
    assert atlas.merge(("r1", 1), 8, 8, cells, 3) == 0
    assert atlas.grid.version == version
    assert atlas.merge(("r1", 1), 8, 8, np.full((4, 4), FREE, np.int8), 6) == 16
    assert atlas.grid.version > version
