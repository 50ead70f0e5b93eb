"""Maps of several robots of one process: what a patch does to a submap is computed once, and the maps are the same."""

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam import submap_atlas
from robrain.algorithms.slam.map_patch import SharedSteps, merge_message, pose_message, to_message
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


@pytest.mark.parametrize("missed", [0, 1, 3])
def test_who_has_missed_a_patch_does_not_take_what_others_made_of_the_next(missed: int) -> None:
    told = [patch("r1", 4, 4 + 3 * number, np.full((3, 3), OCCUPIED, np.int8), 10 + number) for number in range(5)]
    first, other = SubmapAtlas(TEAM), SubmapAtlas(TEAM)
    take_together(first, told)
    take_together(other, [message for number, message in enumerate(told) if number != missed])
    assert first.grid.known_count == 45
    assert other.grid.known_count == 36


def test_a_step_that_enlarges_a_submap_is_taken_only_where_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    cells = np.full((3, 3), OCCUPIED, np.int8)
    told = [patch("r1", 4, 4, cells, 10), patch("r1", 40, 4, cells, 11)]
    first, other = SubmapAtlas(TEAM), SubmapAtlas(TEAM)
    take_together(first, told)
    take_together(other, told[:1])
    monkeypatch.setattr(submap_atlas, "CELLS_MAX", 32 * 32)
    with pytest.raises(ValueError, match="expected submaps of at most"):
        take_together(other, told[1:])
