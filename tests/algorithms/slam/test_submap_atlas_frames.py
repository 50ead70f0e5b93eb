"""Submaps of several map frames in one atlas: only those of its own frame are drawn."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.map_frame import ARENA, MapFrame

GEOMETRY = GridGeometry(0.5, -3.0, 2.0, 24, 20)
OWN, OTHER = MapFrame(5, "r1"), MapFrame(7, "r2")
FRAMES = (ARENA, OWN, OTHER)
KEYS = [("r1", 5), ("r1", 6), ("r2", 7), ("r3", 1)]
ASIDE = Pose2D(1.0, 0.5, 0.0)
"""Two columns and a row."""
PLACES = st.builds(Pose2D, st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(-3.1, 3.1))
BOXES = st.tuples(
    st.integers(-4, 16),
    st.integers(-4, 20),
    arrays(np.int8, (5, 6), elements=st.sampled_from([FREE, OCCUPIED, UNKNOWN])),
)
SUBMAPS = st.lists(st.tuples(st.sampled_from(KEYS), BOXES, PLACES, st.sampled_from(FRAMES)), min_size=1, max_size=6)


def filled(told, frame=ARENA):
    atlas = SubmapAtlas(GEOMETRY, frame)
    for number, (key, (row, column, cells), place, its) in enumerate(told):
        atlas.move(key, place, its)
        atlas.merge(key, row, column, cells, 100 + 10 * number)
    return atlas


def only(told, frame):
    """The map of an atlas that is told nothing of other frames, as if this one were the arena frame."""
    frames = {key: its for key, _, _, its in told}
    places = {key: place for key, _, place, _ in told}
    atlas = SubmapAtlas(GEOMETRY)
    for number, (key, (row, column, cells), _, _) in enumerate(told):
        if frames[key] == frame:
            atlas.move(key, places[key])
            atlas.merge(key, row, column, cells, 100 + 10 * number)
    return atlas.grid.classes()


@settings(deadline=None, max_examples=40)
@given(SUBMAPS, st.sampled_from(FRAMES))
def test_the_map_is_that_of_the_submaps_in_its_frame(told, frame):
    atlas = filled(told, frame)
    assert np.array_equal(atlas.grid.classes(), only(told, frame))


@settings(deadline=None, max_examples=40)
@given(SUBMAPS, st.lists(st.sampled_from(FRAMES), min_size=1, max_size=3))
def test_in_whatever_frames_it_was_drawn_before_the_map_is_the_same(told, frames):
    atlas = filled(told)
    for frame in frames:
        atlas.change_frame(frame)
        assert atlas.frame == frame
        expected = filled(told, frame).grid
        assert np.array_equal(atlas.grid.classes(), expected.classes())
        assert np.array_equal(atlas.grid.stamp_ms, expected.stamp_ms)
        assert atlas.grid.known_count == expected.known_count


@settings(deadline=None, max_examples=40)
@given(SUBMAPS, st.sampled_from(FRAMES))
def test_the_map_of_another_frame_can_be_had_without_changing_ones_own(told, frame):
    atlas = filled(told)
    before, version = atlas.grid.classes(), atlas.grid.version
    composed = atlas.composed(frame)
    assert np.array_equal(composed.classes(), filled(told, frame).grid.classes())
    assert composed is not atlas.grid
    assert np.array_equal(atlas.grid.classes(), before)
    assert atlas.grid.version == version
    assert atlas.frame == ARENA


@pytest.mark.slow
@settings(deadline=None, max_examples=20)
@given(SUBMAPS, st.dictionaries(st.sampled_from(KEYS), PLACES, max_size=4), st.sampled_from(FRAMES))
def test_submaps_that_are_moved_into_a_frame_together_lie_as_if_moved_one_by_one(told, places, frame):
    for drawn in FRAMES:
        together, singly = filled(told, drawn), filled(told, drawn)
        together.move_all(places, frame)
        for key, place in places.items():
            singly.move(key, place, frame)
        assert np.array_equal(together.grid.classes(), singly.grid.classes())
        for key, place in places.items():
            if key in together.submaps:
                assert together.place_of(key, frame) == place
                assert all(together.place_of(key, other) is None for other in FRAMES if other != frame)


ONE = np.full((2, 2), OCCUPIED, np.int8)


@pytest.mark.parametrize("frame", FRAMES)
def test_the_same_frame_again_is_no_change(frame):
    atlas = SubmapAtlas(GEOMETRY, frame)
    atlas.move(("r1", 5), ASIDE, frame)
    atlas.merge(("r1", 5), 4, 6, ONE, 10)
    version = atlas.grid.version
    atlas.change_frame(frame)
    atlas.move(("r1", 5), ASIDE, frame)
    assert atlas.grid.version == version
