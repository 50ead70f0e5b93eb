import zlib

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.mapping.patch_cells import MAX_CELLS, OCCUPIED_MAX
from robrain.algorithms.slam import submap_atlas
from robrain.algorithms.slam.map_patch import (
    MESSAGE_CELLS_MAX,
    in_own_time,
    joined_message,
    map_stamp_ms,
    merge_message,
    pose_message,
    to_message,
    whole_map,
)
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.clock import NS_PER_S
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.geometry import Pose2D
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


def test_a_patch_says_on_the_other_side_what_it_said_on_this():
    atlas = SubmapAtlas(GEOMETRY)
    assert merge_message(atlas, PATCH) == 5
    assert np.array_equal(atlas.grid.classes(), classes_with(2, 3, CELLS))
    assert merge_message(atlas, PATCH) == 0


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


def test_a_message_without_cells_moves_a_submap_and_another_withdraws_it():
    atlas = atlas_of(PATCH)
    merge_message(atlas, over_the_wire(pose_message("r1", GEOMETRY, 0, ASIDE)))
    assert np.array_equal(atlas.grid.classes(), classes_with(3, 5, CELLS))
    merge_message(atlas, over_the_wire(pose_message("r1", GEOMETRY, 0, ASIDE, withdrawn=True)))
    assert atlas.submaps == {}
    assert atlas.grid.known_count == 0


def test_several_patches_travel_in_one_message():
    second = to_message("r1", GEOMETRY, PatchCells(5, 7, CELLS, 2000), 1)
    parts = joined_message("r1", GEOMETRY, [PATCH, second, pose_message("r1", GEOMETRY, 0, ASIDE)])
    atlas = SubmapAtlas(GEOMETRY)
    assert merge_message(atlas, over_the_wire(parts)) == 10
    expected = atlas_of(PATCH, second)
    expected.move(("r1", 0), ASIDE)
    assert np.array_equal(atlas.grid.classes(), expected.grid.classes())
    assert not np.array_equal(atlas.grid.classes(), atlas_of(PATCH, second).grid.classes())


OWN, OTHER = MapFrame(5, "r1"), MapFrame(7, "r2")


def told_in(frame, number=0, place=ASIDE):
    return to_message("r1", GEOMETRY, PatchCells(2, 3, CELLS, 1000), number, place, frame)


def test_a_patch_says_in_which_map_frame_its_submap_lies():
    atlas = atlas_of(over_the_wire(told_in(OWN)))
    assert atlas.place_of(("r1", 0), OWN) == ASIDE
    assert atlas.place_of(("r1", 0)) is None
    assert atlas.grid.known_count == 0
    assert np.array_equal(atlas.composed(OWN).classes(), classes_with(3, 5, CELLS))


def test_submaps_that_are_moved_together_stay_in_the_map_frame_that_each_is_told_in():
    atlas = atlas_of(*[told_in(OWN, number, Pose2D(0.0, 0.0, 0.0)) for number in (0, 1, 2)])
    frames = (OWN, ARENA, OTHER)
    parts = [pose_message("r1", GEOMETRY, number, ASIDE, frame) for number, frame in enumerate(frames)]
    merge_message(atlas, over_the_wire(joined_message("r1", GEOMETRY, parts)))
    for number, frame in enumerate(frames):
        assert atlas.place_of(("r1", number), frame) == ASIDE
    assert np.array_equal(atlas.grid.classes(), classes_with(3, 5, CELLS)), "the one in the arena frame"


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


def test_a_whole_map_is_drawn_once_however_many_submaps_overlap(monkeypatch):
    """Drawn one by one, each would redraw all others, which took a restarted mapper seconds."""
    rng = np.random.default_rng(5)
    geometry = GridGeometry(0.05, 0.0, 0.0, 64, 64)
    one_by_one = SubmapAtlas(geometry)
    for number in range(40):
        for at in rng.integers(0, 64 - 20, (3, 2)).tolist():  # several observation times, so known tiles are redrawn
            cells = rng.choice(np.array([FREE, OCCUPIED, UNKNOWN], np.int8), (20, 20))
            step = PatchCells(*at, cells, int(rng.integers(1, 9000)))
            merge_message(one_by_one, to_message("r1", geometry, step, number, ASIDE))
    whole = whole_map("r1", one_by_one, sorted(one_by_one.submaps))
    together = SubmapAtlas(geometry)
    assert merge_message(together, whole) > 0
    draws = []
    draw = SubmapAtlas._draw
    monkeypatch.setattr(SubmapAtlas, "_draw", lambda atlas, *rest: draws.append(1) or draw(atlas, *rest))
    version = together.grid.version
    assert merge_message(together, whole) == 0  # as after a restart of the mapper
    assert together.grid.version == version
    assert 0 < len(draws) <= 40
    assert np.array_equal(together.grid.log_odds, one_by_one.grid.log_odds)
    assert np.array_equal(together.grid.stamp_ms, one_by_one.grid.stamp_ms)
    assert together.grid.known_count == one_by_one.grid.known_count


def test_what_is_taken_after_a_refused_part_is_drawn():
    spoilt = msgspec.structs.replace(PATCH, submap=1, cells=b"nonsense")
    atlas = SubmapAtlas(GEOMETRY)
    with pytest.raises(ValueError, match="r1"):
        merge_message(atlas, joined_message("r1", GEOMETRY, [PATCH, spoilt]))
    assert np.array_equal(atlas.grid.classes(), classes_with(2, 3, CELLS))
    merge_message(atlas, to_message("r1", GEOMETRY, PatchCells(6, 6, CELLS, 2000), 2))
    assert atlas.grid.classes()[6, 7] == OCCUPIED


def test_there_is_no_whole_map_of_nothing():
    assert whole_map("r1", SubmapAtlas(GEOMETRY), []) is None


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


@pytest.mark.parametrize(("row", "column", "known"), [(8, 3, 2), (-1, 3, 3), (2, 10, 4), (2, -2, 1), (40, 40, 0)])
def test_of_a_patch_that_leaves_the_grid_the_part_inside_is_drawn(row, column, known):
    atlas = SubmapAtlas(GEOMETRY)
    assert merge_message(atlas, over_the_wire(changed(row=row, column=column))) == known
    everywhere = np.full((100, 100), UNKNOWN)
    everywhere[50 + row : 52 + row, 50 + column : 53 + column] = CELLS
    assert np.array_equal(atlas.grid.classes(), everywhere[50:59, 50:62])
    merge_message(atlas, pose_message("r1", GEOMETRY, 0, Pose2D(0.05 * (3 - column), 0.05 * (2 - row), 0.0)))
    assert np.array_equal(atlas.grid.classes(), classes_with(2, 3, CELLS))


def test_a_patch_that_is_nearly_all_wall_is_refused():
    geometry = GridGeometry(0.1, 0.0, 0.0, 200, 200)
    cells = np.full((100, 100), OCCUPIED)
    cells[:30] = FREE
    assert merge_message(SubmapAtlas(geometry), to_message("r1", geometry, PatchCells(0, 0, cells, 5))) == 10_000
    cells[29] = OCCUPIED
    expected = f"at most {OCCUPIED_MAX} occupied cells .* got 7100 and 2900 free ones"
    with pytest.raises(ValueError, match=expected):
        merge_message(SubmapAtlas(geometry), to_message("r1", geometry, PatchCells(0, 0, cells, 5)))


@pytest.mark.parametrize(
    "fields",
    [
        {"cells": b"garbage"},
        {"column": 2000, "rows": 1, "columns": 6000, "cells": zlib.compress(bytes(6000))},  # too wide
        {"tiles_ms": zlib.compress(bytes(4))},  # tiles that do not fit
        {"surfaces": b"garbage"},
        {"rows": 0, "columns": 0, "cells": b"", "surfaces": b"garbage"},
    ],
    ids=["cells", "size", "tiles", "surfaces", "surfaces alone"],
)
def test_a_refused_patch_does_not_move_its_submap(fields):
    atlas = atlas_of(PATCH)
    before, version = atlas.grid.classes(), atlas.grid.version
    with pytest.raises(ValueError, match=r"r1|begins where a tile does|cells a side"):
        merge_message(atlas, changed(T_arena_local=ASIDE, **fields))
    assert atlas.submaps["r1", 0].T_arena_local == Pose2D(0.0, 0.0, 0.0)
    assert (atlas.grid.version, atlas.grid.classes().tolist()) == (version, before.tolist())


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


@given(st.binary(max_size=40))
def test_no_cells_do_anything_but_merge_or_be_refused(cells):
    atlas = SubmapAtlas(GEOMETRY)
    try:
        merge_message(atlas, changed(cells=zlib.compress(cells)))
    except ValueError:
        assert len(cells) != 6
    else:
        assert len(cells) == 6


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
