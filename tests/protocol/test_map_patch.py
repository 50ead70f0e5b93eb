import zlib

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.protocol.model.occupancy_grid import FREE, OCCUPIED, UNKNOWN, GridGeometry, OccupancyGrid, PatchCells
from robrain.protocol.wire.map_patch import MAX_CELLS, geometry_of, map_stamp_ms, merge_message, to_message
from robrain.protocol.wire.messages import MapPatch

GEOMETRY = GridGeometry(0.05, -1.0, -2.0, 12, 9)
CELLS = np.array([[FREE, OCCUPIED, UNKNOWN], [FREE, FREE, OCCUPIED]], np.int8)
PATCH = to_message("r1", GEOMETRY, PatchCells(2, 3, CELLS, 1000))


def changed(**fields):
    return msgspec.structs.replace(PATCH, **fields)


def test_a_patch_says_on_the_other_side_what_it_said_on_this():
    grid = OccupancyGrid(GEOMETRY)
    assert merge_message(grid, PATCH) == 5
    expected = np.full(GEOMETRY.shape, UNKNOWN, np.int8)
    expected[2:4, 3:6] = CELLS
    assert np.array_equal(grid.classes(), expected)
    assert merge_message(grid, PATCH) == 0


@given(st.data())
def test_every_patch_survives_the_wire(data):
    row, column = data.draw(st.integers(0, GEOMETRY.height - 1)), data.draw(st.integers(0, GEOMETRY.width - 1))
    rows = data.draw(st.integers(1, GEOMETRY.height - row))
    columns = data.draw(st.integers(1, GEOMETRY.width - column))
    cells = data.draw(arrays(np.int8, (rows, columns), elements=st.sampled_from([FREE, OCCUPIED, UNKNOWN])))
    message = to_message("r1", GEOMETRY, PatchCells(row, column, cells, 5))
    received = msgspec.json.decode(msgspec.json.encode(message), type=MapPatch)
    assert received == message
    grid = OccupancyGrid(GEOMETRY)
    assert merge_message(grid, received) == np.count_nonzero(cells != UNKNOWN)
    assert np.array_equal(grid.classes()[row : row + rows, column : column + columns], cells)


def test_a_patch_brings_its_geometry():
    assert geometry_of(PATCH) == GEOMETRY


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
        (changed(cells=b""), "expected 6 cells in its patch, got 0"),  # nothing
        (changed(cells=b"garbage"), "do not inflate"),  # no zlib
        (changed(cells=zlib.compress(bytes(5))), "got 5"),  # a cell too few
        (changed(cells=zlib.compress(bytes(7))), "got 7"),  # a cell too many
        (changed(cells=PATCH.cells[:-7]), "got [0-5]$"),  # cut
        (changed(cells=zlib.compress(bytes(1 << 26), 9)), "got 7"),  # a bomb: 64 MB out of 64 kB
        (changed(row=8), "leaves the grid"),  # beyond the last row
        (changed(row=-1), "leaves the grid"),  # before the first row
        (changed(observed_ms=-1), "stamp_ms"),  # before the run
        (changed(observed_ms=1 << 31), "stamp_ms"),  # more than 31 bits
    ],
)
def test_a_patch_that_is_not_what_it_says_is_refused_and_changes_nothing(patch, sentence):
    grid = OccupancyGrid(GEOMETRY)
    with pytest.raises(ValueError, match=sentence):
        merge_message(grid, patch)
    assert grid.known_count == 0
    assert np.all(grid.classes() == UNKNOWN)


@given(st.binary(max_size=40))
def test_no_cells_do_anything_but_merge_or_be_refused(cells):
    grid = OccupancyGrid(GEOMETRY)
    try:
        merge_message(grid, changed(cells=zlib.compress(cells)))
    except ValueError:
        assert len(cells) != 6
    else:
        assert len(cells) == 6


@given(st.integers(0, 1 << 63))
def test_stamps_of_maps_fit_a_grid(stamp_ns):
    assert 0 <= map_stamp_ms(stamp_ns) < 1 << 31


def test_stamps_of_maps_are_milliseconds():
    assert map_stamp_ms(1_999_999) == 1
    assert map_stamp_ms((1 << 31) * 1_000_000) == 0
