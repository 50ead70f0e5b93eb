"""Maps of several robots of one process: what a patch does to a submap is computed once, and the maps are the same."""

from copy import copy

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam import submap_atlas
from robrain.algorithms.slam.map_patch import SharedSteps, merge_message, pose_message, to_message, whole_map
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

TEAM = GridGeometry(0.5, -3.0, 2.0, 40, 32)
CLASS = st.sampled_from([FREE, OCCUPIED, UNKNOWN])
CELLS = arrays(np.int8, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=CLASS)
PLACE = st.one_of(
    st.just(IDENTITY), st.builds(Pose2D, st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(-3.1, 3.1))
)


SEEN = np.full((3, 3), OCCUPIED, np.int8)


def patch(robot, row, column, cells, stamp_ms, place=IDENTITY):
    return to_message(robot, TEAM, PatchCells(row, column, cells, stamp_ms), 0, place)


@st.composite
def messages(draw):
    """What two robots tell: cells of their submaps, mostly newer from one to the next; at times a submap moves."""
    told, places = [], {"r1": draw(PLACE), "r2": IDENTITY}
    for number in range(draw(st.integers(1, 12))):
        robot = draw(st.sampled_from(["r1", "r2"]))
        if draw(st.integers(0, 5)) == 0:
            places[robot] = draw(PLACE)
            told.append(pose_message(robot, TEAM, 0, places[robot]))
        else:
            at = draw(st.integers(-8, 40)), draw(st.integers(-8, 40))
            if draw(st.integers(0, 9)) == 0:
                places[robot] = draw(PLACE)  # the patch itself says so
            told.append(patch(robot, *at, draw(CELLS), draw(st.integers(0, 2)) + number // 2, places[robot]))
    return told


def take_together(atlas, told):
    """As a mapper takes the messages of one step."""
    shared, alone = SharedSteps(atlas), 0
    for message in told:
        if not shared.add(message):
            alone += 1
            shared.flush()
            merge_message(atlas, message)
    shared.flush()
    return alone


def same(one, other, *, versions=True):
    assert np.array_equal(one.grid.classes(), other.grid.classes())
    assert np.array_equal(one.grid.stamp_ms, other.grid.stamp_ms)
    assert one.grid.known_count == other.grid.known_count
    assert sorted(one.submaps) == sorted(other.submaps)
    for key, submap in one.submaps.items():
        its = other.submaps[key]
        assert (submap.box, submap.occupied, submap.size) == (its.box, its.occupied, its.size)
        assert submap.version == its.version or not versions
        assert np.array_equal(submap.evidence, its.evidence)
        assert np.array_equal(submap.stamp_ms, its.stamp_ms)


@pytest.mark.slow
@settings(deadline=None, max_examples=50)
@given(messages())
def test_who_shares_steps_has_the_map_of_one_who_computes_each_of_them(told: list[MapPatch]) -> None:
    alone, first, second = SubmapAtlas(TEAM), SubmapAtlas(TEAM), SubmapAtlas(TEAM)
    for message in told:
        merge_message(alone, msgspec.structs.replace(message))
    take_together(first, told)
    take_together(second, told)
    same(alone, first)
    same(alone, second)
    assert all(second.submaps[key].evidence is submap.evidence for key, submap in first.submaps.items())


def test_the_second_who_hears_newer_cells_of_a_known_submap_computes_nothing() -> None:
    cells = np.full((3, 3), OCCUPIED, np.int8)
    told = [patch("r1", 4, 4 + number, cells, 10 + number) for number in range(5)]
    first, second = SubmapAtlas(TEAM), SubmapAtlas(TEAM)
    assert take_together(first, told) == 5
    assert take_together(second, told) == 1  # the submap is new to it
    assert second.grid.known_count == first.grid.known_count == 3 * 7


@pytest.mark.parametrize("missed", [0, 1, 3])
def test_who_has_missed_a_patch_does_not_take_what_others_made_of_the_next(missed: int) -> None:
    told = [patch("r1", 4, 4 + 3 * number, np.full((3, 3), OCCUPIED, np.int8), 10 + number) for number in range(5)]
    first, other = SubmapAtlas(TEAM), SubmapAtlas(TEAM)
    take_together(first, told)
    take_together(other, [message for number, message in enumerate(told) if number != missed])
    assert first.grid.known_count == 45
    assert other.grid.known_count == 36


def test_who_comes_late_and_takes_the_whole_map_shares_the_next_patch_but_one() -> None:
    told = [patch("r1", 4, 4 + 3 * number, SEEN, 10 + number) for number in range(4)]
    first, late = SubmapAtlas(TEAM), SubmapAtlas(TEAM)
    take_together(first, told[:2])
    whole = whole_map("r1", first, [("r1", 0)])
    assert whole is not None
    merge_message(late, whole)
    take_together(first, told[2:])
    assert take_together(late, told[2:]) == 1
    same(first, late, versions=False)
    assert late.submaps["r1", 0].evidence is first.submaps["r1", 0].evidence


def test_a_patch_of_what_is_no_grid_is_left_to_those_who_refuse_it() -> None:
    nowhere = msgspec.structs.replace(patch("r1", 4, 4, SEEN, 10), width=0)
    atlas = SubmapAtlas(TEAM)
    merge_message(atlas, patch("r1", 4, 4, SEEN, 10))
    assert not SharedSteps(atlas).add(nowhere)


def test_a_robot_of_another_grid_does_not_take_what_was_computed_for_this_one() -> None:
    cells = np.full((3, 3), OCCUPIED, np.int8)
    before, message = patch("r1", 4, 4, cells, 10), patch("r1", 4, 4, cells, 11)
    first, other = SubmapAtlas(TEAM), SubmapAtlas(GridGeometry(0.5, -3.0, 2.0, 41, 32))
    merge_message(first, before)
    other.submaps["r1", 0] = copy(first.submaps["r1", 0])
    merge_message(first, message)
    assert not SharedSteps(other).add(message)
    with pytest.raises(ValueError, match="r1 maps"):
        merge_message(other, message)


def test_a_step_that_enlarges_a_submap_is_taken_only_where_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    cells = np.full((3, 3), OCCUPIED, np.int8)
    told = [patch("r1", 4, 4, cells, 10), patch("r1", 40, 4, cells, 11)]
    first, other = SubmapAtlas(TEAM), SubmapAtlas(TEAM)
    take_together(first, told)
    take_together(other, told[:1])
    monkeypatch.setattr(submap_atlas, "CELLS_MAX", 32 * 32)
    with pytest.raises(ValueError, match="expected submaps of at most"):
        take_together(other, told[1:])


LATER = {
    "as old as what it contradicts": patch("r1", 4, 4, np.full((3, 3), FREE, np.int8), 10),
    "of a submap that has moved": patch("r1", 4, 4, SEEN, 11, Pose2D(1.0, 0.5, 0.0)),
}


@pytest.mark.parametrize("later", LATER.values(), ids=LATER)
def test_a_patch_that_does_more_than_add_newer_cells_is_taken_alone(later: MapPatch) -> None:
    alone, first, second = SubmapAtlas(TEAM), SubmapAtlas(TEAM), SubmapAtlas(TEAM)
    told = [patch("r1", 4, 4, SEEN, 10), later]
    for message in told:
        merge_message(alone, msgspec.structs.replace(message))
    assert take_together(first, told) == take_together(second, told) == 2
    same(alone, first)
    same(alone, second)
