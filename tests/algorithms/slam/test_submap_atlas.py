"""Submaps of several map frames in one atlas: only those of its own frame are drawn."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.slam import submap_atlas
from robrain.algorithms.slam.submap import BLOCK_CELLS, SURFACE, TILE_CELLS, Submap
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.map_frame import ARENA, MapFrame

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


def merge_statement(atlas, number, statement):
    """`number` grows with what a robot says; several robots may have seen things at the same time."""
    kind, key, (row, column, cells), place = statement
    if kind == "take":
        atlas.merge(key, row, column, cells, 100 + 10 * number)
    elif kind == "move":
        atlas.move(key, place)
    else:
        atlas.withdraw(key)


def atlas_after(history, order):
    atlas, next_of = SubmapAtlas(GEOMETRY), dict.fromkeys(ROBOTS, 0)
    for robot in order:
        merge_statement(atlas, next_of[robot], history[robot][next_of[robot]])
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
    one = atlas_after(history, order)
    random.shuffle(order)
    other = atlas_after(history, order)
    assert np.array_equal(one.grid.classes(), other.grid.classes())
    assert np.array_equal(one.grid.stamp_ms, other.grid.stamp_ms)


@settings(deadline=None, max_examples=20)
@given(histories(), st.randoms(use_true_random=False))
def test_the_map_is_what_the_rule_says_of_all_submaps_where_they_lie(history, random):
    order = [robot for robot in ROBOTS for _ in history[robot]]
    random.shuffle(order)
    atlas = atlas_after(history, order)
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
    assert atlas.grid.classes()[2, 0] == OCCUPIED, "its place was published before those of two others"
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


OWN, OTHER = MapFrame(5, "r1"), MapFrame(7, "r2")
FRAMES = (ARENA, OWN, OTHER)
KEYS = [("r1", 5), ("r1", 6), ("r2", 7), ("r3", 1)]
PLACES = st.builds(Pose2D, st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(-3.1, 3.1))
BOXES = st.tuples(
    st.integers(-4, 16),
    st.integers(-4, 20),
    arrays(np.int8, (5, 6), elements=st.sampled_from([FREE, OCCUPIED, UNKNOWN])),
)
SUBMAPS = st.lists(st.tuples(st.sampled_from(KEYS), BOXES, PLACES, st.sampled_from(FRAMES)), min_size=1, max_size=6)


def filled(submaps, frame=ARENA):
    atlas = SubmapAtlas(GEOMETRY, frame)
    for number, (key, (row, column, cells), place, its) in enumerate(submaps):
        atlas.move(key, place, its)
        atlas.merge(key, row, column, cells, 100 + 10 * number)
    return atlas


def only(submaps, frame):
    """The map of an atlas that receives nothing of other frames, as if this one were the arena frame."""
    frames = {key: its for key, _, _, its in submaps}
    places = {key: place for key, _, place, _ in submaps}
    atlas = SubmapAtlas(GEOMETRY)
    for number, (key, (row, column, cells), _, _) in enumerate(submaps):
        if frames[key] == frame:
            atlas.move(key, places[key])
            atlas.merge(key, row, column, cells, 100 + 10 * number)
    return atlas.grid.classes()


@settings(deadline=None, max_examples=40)
@given(SUBMAPS, st.sampled_from(FRAMES))
def test_the_map_is_that_of_the_submaps_in_its_frame(submaps, frame):
    atlas = filled(submaps, frame)
    assert np.array_equal(atlas.grid.classes(), only(submaps, frame))


@settings(deadline=None, max_examples=40)
@given(SUBMAPS, st.sampled_from(FRAMES))
def test_the_map_of_another_frame_can_be_had_without_changing_ones_own(submaps, frame):
    atlas = filled(submaps)
    before, version = atlas.grid.classes(), atlas.grid.version
    composed = atlas.composed(frame)
    assert np.array_equal(composed.classes(), filled(submaps, frame).grid.classes())
    assert composed is not atlas.grid
    assert np.array_equal(atlas.grid.classes(), before)
    assert atlas.grid.version == version
    assert atlas.frame == ARENA


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


@settings(deadline=None, max_examples=40)
@given(SUBMAPS, st.lists(st.sampled_from(FRAMES), min_size=1, max_size=3))
def test_in_whatever_frames_it_was_drawn_before_the_map_is_the_same(submaps, frames):
    atlas = filled(submaps)
    for frame in frames:
        atlas.change_frame(frame)
        assert atlas.frame == frame
        expected = filled(submaps, frame).grid
        assert np.array_equal(atlas.grid.classes(), expected.classes())
        assert np.array_equal(atlas.grid.stamp_ms, expected.stamp_ms)
        assert atlas.grid.known_count == expected.known_count


@pytest.mark.slow
@settings(deadline=None, max_examples=20)
@given(SUBMAPS, st.dictionaries(st.sampled_from(KEYS), PLACES, max_size=4), st.sampled_from(FRAMES))
def test_submaps_that_are_moved_into_a_frame_together_lie_as_if_moved_one_by_one(submaps, places, frame):
    for drawn in FRAMES:
        together, singly = filled(submaps, drawn), filled(submaps, drawn)
        together.move_all(places, frame)
        for key, place in places.items():
            singly.move(key, place, frame)
        assert np.array_equal(together.grid.classes(), singly.grid.classes())
        for key, place in places.items():
            if key in together.submaps:
                assert together.place_of(key, frame) == place
                assert all(together.place_of(key, other) is None for other in FRAMES if other != frame)
