"""The limits of what a teammate may publish of its submaps: how far away, how many surfaces, and what comes last."""

import zlib

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.mapping.patch_cells import MAX_CELLS, OCCUPIED_MAX
from robrain.algorithms.slam import submap_atlas
from robrain.algorithms.slam.map_patch import (
    MESSAGE_CELLS_MAX,
    SharedSteps,
    in_own_time,
    is_near_grid,
    joined_message,
    map_stamp_ms,
    merge_message,
    pose_message,
    to_message,
    whole_map,
)
from robrain.algorithms.slam.submap import SURFACE, SURFACES_MAX
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.clock import NS_PER_S
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.map_frame import ARENA, MapFrame

GEOMETRY = GridGeometry(0.05, -1.0, -2.0, 12, 9)
CELLS = np.array([[FREE, OCCUPIED, UNKNOWN], [FREE, FREE, OCCUPIED]], np.int8)
PATCH = to_message("r1", GEOMETRY, PatchCells(2, 3, CELLS, 1000))
ASIDE = Pose2D(0.1, 0.05, 0.0)
"""Two columns and a row of `GEOMETRY`."""


def changed(**fields):
    return msgspec.structs.replace(PATCH, **fields)


def over_the_wire(message):
    return msgspec.json.decode(msgspec.json.encode(message), type=MapPatch)


def atlas_of(*messages):
    atlas = SubmapAtlas(GEOMETRY)
    for message in messages:
        merge_message(atlas, message)
    return atlas


def classes_with(row, column, cells):
    expected = np.full(GEOMETRY.shape, UNKNOWN, np.int8)
    expected[row : row + cells.shape[0], column : column + cells.shape[1]] = cells
    return expected


@pytest.mark.slow
@given(st.data())
def test_every_patch_survives_the_wire(data):
    row, column = data.draw(st.integers(0, GEOMETRY.height - 1)), data.draw(st.integers(0, GEOMETRY.width - 1))
    rows = data.draw(st.integers(1, GEOMETRY.height - row))
    columns = data.draw(st.integers(1, GEOMETRY.width - column))
    cells = data.draw(arrays(np.int8, (rows, columns), elements=st.sampled_from([FREE, OCCUPIED, UNKNOWN])))
    message = to_message("r1", GEOMETRY, PatchCells(row, column, cells, 5), 3)
    received = over_the_wire(message)
    assert received == message
    atlas = SubmapAtlas(GEOMETRY)
    assert merge_message(atlas, received) == np.count_nonzero(cells != UNKNOWN)
    assert np.array_equal(atlas.grid.classes(), classes_with(row, column, cells))
    assert set(atlas.submaps) == {("r1", 3)}


def test_a_patch_is_drawn_where_its_submap_lies():
    atlas = atlas_of(over_the_wire(to_message("r1", GEOMETRY, PatchCells(2, 3, CELLS, 1000), 4, ASIDE)))
    assert np.array_equal(atlas.grid.classes(), classes_with(3, 5, CELLS))


def test_a_whole_map_says_all_that_is_known_and_when_each_tile_was_seen():
    late = to_message("r1", GEOMETRY, PatchCells(8, 9, CELLS[:1], 9000))
    atlas = atlas_of(PATCH, late, to_message("r2", GEOMETRY, PatchCells(4, 4, CELLS, 500), 2, ASIDE))
    keys = sorted(atlas.submaps)
    elsewhere = atlas_of(over_the_wire(whole_map("r1", atlas, keys)))
    assert np.array_equal(elsewhere.grid.classes(), atlas.grid.classes())
    assert np.array_equal(elsewhere.grid.stamp_ms, atlas.grid.stamp_ms)
    assert {key: submap.T_arena_local for key, submap in elsewhere.submaps.items()} == {
        ("r1", 0): Pose2D(0.0, 0.0, 0.0),
        ("r2", 2): ASIDE,
    }
    # A patch between the two times is old news in the one tile and new in the other.
    between = np.array([[OCCUPIED, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, OCCUPIED]], np.int8)
    in_between = to_message("r3", GEOMETRY, PatchCells(3, 3, between, 5000))
    beside = to_message("r3", GEOMETRY, PatchCells(8, 9, np.array([[OCCUPIED]], np.int8), 5000))
    for message in (in_between, beside):
        merge_message(elsewhere, message)
    assert elsewhere.grid.classes()[3, 3] == OCCUPIED
    assert elsewhere.grid.classes()[8, 9] == FREE


def test_hearsay_fills_gaps_and_does_not_contradict_the_robot_itself():
    own = to_message("r2", GEOMETRY, PatchCells(2, 3, CELLS, 1000))
    old = to_message("r2", GEOMETRY, PatchCells(2, 3, np.full((2, 3), OCCUPIED), 2000), 0, ASIDE)
    other = to_message("r2", GEOMETRY, PatchCells(6, 3, CELLS, 10), 1)
    atlas = atlas_of(own, joined_message("r1", GEOMETRY, [old, other]))
    assert np.array_equal(atlas.grid.classes(), atlas_of(own, other).grid.classes())
    assert set(atlas.submaps) == {("r2", 0), ("r2", 1)}


def test_parts_of_parts_are_refused():
    nested = joined_message("r1", GEOMETRY, [joined_message("r1", GEOMETRY, [PATCH])])
    with pytest.raises(ValueError, match="a part of its patch has parts"):
        merge_message(SubmapAtlas(GEOMETRY), nested)


@pytest.mark.parametrize(
    ("patch", "sentence"),
    [
        (changed(resolution_m=0.1), "r1 maps .* expected"),  # coarser cells
        (changed(origin_x_m=0.0), "r1 maps .* expected"),  # elsewhere
        (changed(width=13), "r1 maps .* expected"),  # wider
        (changed(resolution_m=0.0), "resolution_m"),  # no grid at all
        (changed(height=-1), "height"),  # no grid at all
        (changed(rows=0), "got 0"),  # no cells
        (changed(rows=-2), "got -6"),  # fewer than none
        (changed(rows=-2, columns=-3), "negative|dimension"),  # whose product looks right
        (changed(rows=1 << 20, columns=1 << 20), f"1 to {MAX_CELLS} cells"),  # a terabyte
        (changed(cells=b""), "expected 6 bytes of cells in its patch, got 0"),  # nothing
        (changed(cells=b"garbage"), "do not inflate"),  # no zlib
        (changed(cells=zlib.compress(bytes(5))), "got 5"),  # a cell too few
        (changed(cells=zlib.compress(bytes(7))), "got 7"),  # a cell too many
        (changed(cells=PATCH.cells[:-7]), "got [0-5]$"),  # cut
        (changed(cells=zlib.compress(bytes(1 << 26), 9)), "got 7"),  # a bomb: 64 MB out of 64 kB
        (changed(rows=1, columns=6000, cells=zlib.compress(bytes(6000))), "at most 4096 cells a side"),  # too wide
        (changed(row=0, column=0, tiles_ms=b"garbage"), "do not inflate"),  # no times of tiles
        (changed(row=0, column=0, tiles_ms=zlib.compress(bytes(8))), "expected 4 bytes"),  # times of too many tiles
        (changed(row=0, column=0, tiles_ms=zlib.compress(b"\xe9\x03\0\0")), "from 0 to 1000 ms"),  # seen afterwards
        (changed(row=0, column=0, tiles_ms=zlib.compress(b"\xff" * 4)), "from 0 to 1000 ms"),  # seen before the run
        (changed(tiles_ms=zlib.compress(bytes(4))), "begins where a tile does"),  # tiles that do not fit
    ],
)
def test_a_patch_that_is_not_what_it_says_is_refused_and_changes_nothing(patch, sentence):
    atlas = SubmapAtlas(GEOMETRY)
    with pytest.raises(ValueError, match=sentence):
        merge_message(atlas, patch)
    assert atlas.submaps == {}
    assert atlas.grid.known_count == 0
    assert np.all(atlas.grid.classes() == UNKNOWN)


@pytest.mark.parametrize(
    "fields",
    [
        {"observed_ms": -1},  # before the run
        {"observed_ms": 1 << 31},  # more than 31 bits
        {"row": 1 << 17},  # kilometres away
        {"column": -(1 << 17)},
        {"submap": -1},
        {"rows": -2},
        {"width": 1 << 25},
        {"T_arena_local": Pose2D(1e7, 0.0, 0.0)},
        {"parts": [changed(observed_ms=-1)]},
        {"parts": [changed(parts=[])] * 8193},
    ],
    ids=lambda fields: next(iter(fields)),
)
def test_numbers_that_no_patch_has_are_refused_where_it_is_decoded(fields):
    with pytest.raises(msgspec.ValidationError):
        over_the_wire(changed(**fields))


def test_a_patch_that_is_nearly_all_wall_is_refused():
    geometry = GridGeometry(0.1, 0.0, 0.0, 200, 200)
    cells = np.full((100, 100), OCCUPIED)
    cells[:30] = FREE
    assert merge_message(SubmapAtlas(geometry), to_message("r1", geometry, PatchCells(0, 0, cells, 5))) == 10_000
    cells[29] = OCCUPIED
    expected = f"at most {OCCUPIED_MAX} occupied cells .* got 7100 and 2900 free ones"
    with pytest.raises(ValueError, match=expected):
        merge_message(SubmapAtlas(geometry), to_message("r1", geometry, PatchCells(0, 0, cells, 5)))


def test_what_others_tell_leaves_room_for_the_robots_own_cells(monkeypatch):
    monkeypatch.setattr(submap_atlas, "SUBMAPS_MAX", 4)
    atlas = SubmapAtlas(GEOMETRY)
    with pytest.raises(ValueError, match="at most 3 submaps"):
        merge_message(atlas, joined_message("r1", GEOMETRY, [changed(submap=number) for number in range(4)]))
    assert len(atlas.submaps) == 3
    assert atlas.merge(("r0", 0), 2, 3, CELLS, 1000) == 0
    assert len(atlas.submaps) == 4


def test_a_message_of_more_cells_than_an_atlas_holds_is_refused_unread():
    part = changed(rows=4096, columns=4096, cells=b"garbage")
    message = joined_message("r1", GEOMETRY, [part] * (MESSAGE_CELLS_MAX // 4096**2 + 1))
    with pytest.raises(ValueError, match=f"at most {MESSAGE_CELLS_MAX} cells in a message"):
        merge_message(SubmapAtlas(GEOMETRY), message)


@pytest.mark.parametrize("in_part", [False, True])
def test_a_patch_from_the_future_is_no_claim(in_part):
    def message(observed_ms):
        patch = changed(observed_ms=observed_ms)
        return joined_message("r1", GEOMETRY, [PATCH, patch]) if in_part else patch

    assert in_own_time(message(6_000), 1_000_000_000) == message(6_000)
    with pytest.raises(ValueError, match=r"r1: its patch claims to be observed 5\.0 s from now"):
        in_own_time(message(6_001), 1_000_000_000)


@pytest.mark.parametrize("ahead_s", [20 * 86_400, 54 * 365 * 86_400, -54 * 365 * 86_400, -7200, 6])
@pytest.mark.parametrize("now_s", [1_800_000_000, (1 << 31) * 837 // 1000 + 2])
def test_patches_of_a_robot_whose_clock_differs_are_observed_when_they_were(now_s, ahead_s):
    """Also where the times of observation of one of the two, or of the robot's older cells, have wrapped."""
    sent_s = now_s + ahead_s
    atlas = atlas_of(changed(observed_ms=map_stamp_ms((sent_s - 40) * NS_PER_S)))
    whole = whole_map("r1", atlas, atlas.submaps)
    message = in_own_time(msgspec.structs.replace(whole, stamp_ns=sent_s * NS_PER_S), now_s * NS_PER_S)
    part = message.parts[0]
    assert part.observed_ms == map_stamp_ms((now_s - 40) * NS_PER_S)
    assert set(np.frombuffer(zlib.decompress(part.tiles_ms), np.int32)) >= {part.observed_ms}
    merge_message(SubmapAtlas(GEOMETRY), message)


@given(st.integers(0, 1 << 63))
def test_stamps_of_maps_fit_a_grid(stamp_ns):
    assert 0 <= map_stamp_ms(stamp_ns) < 1 << 31


GRID = GridGeometry(0.1, -3.0, 2.0, 60, 40)
"""60 cells wide, 40 high."""
KEY = ("r2", 7)


def floor(row: int = 0, column: int = 0, cells: int = 1, at: Pose2D = IDENTITY) -> MapPatch:
    patch = PatchCells(row, column, np.full((1, cells), FREE, np.int8), 5)
    return to_message("r2", GRID, patch, 7, at)


def finished(surfaces: np.ndarray | bytes) -> MapPatch:
    if isinstance(surfaces, bytes):
        return msgspec.structs.replace(pose_message("r2", GRID, 7, IDENTITY), surfaces=zlib.compress(surfaces))
    return pose_message("r2", GRID, 7, IDENTITY, surfaces=surfaces)


def surfaces_of(count: int) -> np.ndarray:
    surfaces = np.zeros(count, SURFACE)
    surfaces["row"], surfaces["column"] = np.arange(count) // 60, np.arange(count) % 60
    surfaces["right"], surfaces["view"] = 3, 128
    return surfaces


@pytest.mark.parametrize(
    ("row", "column", "is_near"),
    [
        (-2000, 0, True),
        (-2001, 0, False),
        (40 + 2000, 0, True),
        (40 + 2001, 0, False),
        (0, -2000, True),
        (0, -2001, False),
        (0, 60 + 2000, True),
        (0, 60 + 2001, False),
        (-2000, 60 + 2000, True),
        (20, 30, True),
    ],
)
def test_a_patch_may_lie_two_thousand_cells_outside_the_grid_and_no_farther(
    row: int, column: int, is_near: bool
) -> None:
    assert is_near_grid(GRID, row, column) == is_near
    atlas = SubmapAtlas(GRID)
    if is_near:
        merge_message(atlas, floor(row, column))
        assert KEY in atlas.submaps
        return
    with pytest.raises(ValueError, match="at most 2000 cells outside the grid"):
        merge_message(atlas, floor(row, column))
    assert not atlas.submaps


@pytest.mark.parametrize("count", [0, 1, 300, SURFACES_MAX])
def test_a_finished_submap_has_the_surfaces_that_were_told(count: int) -> None:
    atlas, surfaces = SubmapAtlas(GRID), surfaces_of(count)
    merge_message(atlas, floor())
    assert atlas.submaps[KEY].surfaces is None
    assert merge_message(atlas, finished(surfaces)) == 0
    kept = atlas.submaps[KEY].surfaces
    assert kept is not None
    assert np.array_equal(kept, surfaces)
    merge_message(atlas, floor(column=1))
    assert atlas.submaps[KEY].surfaces is kept, "later cells do not change the surfaces"


@pytest.mark.parametrize(
    "surfaces",
    [
        surfaces_of(SURFACES_MAX + 1).tobytes(),
        surfaces_of(3).tobytes()[:-1],
        surfaces_of(3).tobytes() + b"!",
        bytes(100 * SURFACES_MAX),  # what inflates without end is not inflated to its end
    ],
)
def test_surfaces_that_are_too_many_or_cut_off_are_refused(surfaces: bytes) -> None:
    atlas = SubmapAtlas(GRID)
    merge_message(atlas, floor())
    with pytest.raises(ValueError, match=f"at most {SURFACES_MAX} surfaces of 11 bytes"):
        merge_message(atlas, finished(surfaces))
    assert atlas.submaps[KEY].surfaces is None


TEAM = GridGeometry(0.5, -3.0, 2.0, 40, 32)
CLASS = st.sampled_from([FREE, OCCUPIED, UNKNOWN])
PATCH_CELLS = arrays(np.int8, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=CLASS)
PLACE = st.one_of(
    st.just(IDENTITY), st.builds(Pose2D, st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(-3.1, 3.1))
)


def patch(robot, row, column, cells, stamp_ms, place=IDENTITY):
    return to_message(robot, TEAM, PatchCells(row, column, cells, stamp_ms), 0, place)


@st.composite
def messages(draw):
    """Patches of two robots: cells of their submaps, mostly newer from one to the next; at times a submap moves."""
    patches, places = [], {"r1": draw(PLACE), "r2": IDENTITY}
    for number in range(draw(st.integers(1, 12))):
        robot = draw(st.sampled_from(["r1", "r2"]))
        if draw(st.integers(0, 5)) == 0:
            places[robot] = draw(PLACE)
            patches.append(pose_message(robot, TEAM, 0, places[robot]))
        else:
            at = draw(st.integers(-8, 40)), draw(st.integers(-8, 40))
            if draw(st.integers(0, 9)) == 0:
                places[robot] = draw(PLACE)  # the patch itself says so
            patches.append(patch(robot, *at, draw(PATCH_CELLS), draw(st.integers(0, 2)) + number // 2, places[robot]))
    return patches


def merge_together(atlas, patches):
    """Merge as a mapper merges the messages of one step."""
    shared, alone = SharedSteps(atlas), 0
    for message in patches:
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
def test_who_shares_steps_has_the_map_of_one_who_computes_each_of_them(patches: list[MapPatch]) -> None:
    alone, first, second = SubmapAtlas(TEAM), SubmapAtlas(TEAM), SubmapAtlas(TEAM)
    for message in patches:
        merge_message(alone, msgspec.structs.replace(message))
    merge_together(first, patches)
    merge_together(second, patches)
    same(alone, first)
    same(alone, second)
    assert all(second.submaps[key].evidence is submap.evidence for key, submap in first.submaps.items())


@pytest.mark.parametrize("missed", [0, 1, 3])
def test_who_has_missed_a_patch_does_not_take_what_others_made_of_the_next(missed: int) -> None:
    patches = [patch("r1", 4, 4 + 3 * number, np.full((3, 3), OCCUPIED, np.int8), 10 + number) for number in range(5)]
    first, other = SubmapAtlas(TEAM), SubmapAtlas(TEAM)
    merge_together(first, patches)
    merge_together(other, [message for number, message in enumerate(patches) if number != missed])
    assert first.grid.known_count == 45
    assert other.grid.known_count == 36


OWN, OTHER = MapFrame(5, "r1"), MapFrame(7, "r2")


def patch_in(frame, number=0, place=ASIDE):
    return to_message("r1", GEOMETRY, PatchCells(2, 3, CELLS, 1000), number, place, frame)


def test_submaps_that_are_moved_together_stay_in_the_map_frame_that_each_is_told_in():
    atlas = atlas_of(*[patch_in(OWN, number, Pose2D(0.0, 0.0, 0.0)) for number in (0, 1, 2)])
    frames = (OWN, ARENA, OTHER)
    parts = [pose_message("r1", GEOMETRY, number, ASIDE, frame) for number, frame in enumerate(frames)]
    merge_message(atlas, over_the_wire(joined_message("r1", GEOMETRY, parts)))
    for number, frame in enumerate(frames):
        assert atlas.place_of(("r1", number), frame) == ASIDE
    assert np.array_equal(atlas.grid.classes(), classes_with(3, 5, CELLS)), "the one in the arena frame"


def test_a_message_without_cells_moves_a_submap_and_another_withdraws_it():
    atlas = atlas_of(PATCH)
    merge_message(atlas, over_the_wire(pose_message("r1", GEOMETRY, 0, ASIDE)))
    assert np.array_equal(atlas.grid.classes(), classes_with(3, 5, CELLS))
    merge_message(atlas, over_the_wire(pose_message("r1", GEOMETRY, 0, ASIDE, withdrawn=True)))
    assert atlas.submaps == {}
    assert atlas.grid.known_count == 0
