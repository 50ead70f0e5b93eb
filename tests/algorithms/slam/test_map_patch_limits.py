"""The limits of what a mate may tell of its submaps: how far away, how many surfaces, and what comes last."""

import zlib

import msgspec
import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import is_near_grid, joined_message, merge_message, pose_message, to_message
from robrain.algorithms.slam.submap import SURFACE, SURFACES_MAX
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, GridGeometry

GRID = GridGeometry(0.1, -3.0, 2.0, 60, 40)
"""60 cells wide, 40 high."""
KEY = ("r2", 7)
THERE = Pose2D(1.0, -0.5, 0.3)


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
    told = atlas.submaps[KEY].surfaces
    assert told is not None
    assert np.array_equal(told, surfaces)
    merge_message(atlas, floor(column=1))
    assert atlas.submaps[KEY].surfaces is told, "later cells do not change the surfaces"


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


def test_of_several_places_in_one_message_the_last_one_counts() -> None:
    elsewhere = Pose2D(0.4, 0.2, 0.0)
    for parts, place in (
        ([pose_message("r2", GRID, 7, elsewhere), floor(at=THERE)], THERE),
        ([floor(at=THERE), pose_message("r2", GRID, 7, elsewhere)], elsewhere),
        ([pose_message("r2", GRID, 7, elsewhere), pose_message("r2", GRID, 7, THERE)], THERE),
    ):
        atlas = SubmapAtlas(GRID)
        merge_message(atlas, floor())
        merge_message(atlas, joined_message("r2", GRID, parts))
        assert atlas.place_of(KEY) == place


def test_a_submap_that_is_only_moved_or_withdrawn_tells_of_no_changed_cell() -> None:
    atlas = SubmapAtlas(GRID)
    assert merge_message(atlas, floor(cells=5)) == 5
    assert merge_message(atlas, pose_message("r2", GRID, 7, THERE)) == 0
    assert merge_message(atlas, pose_message("r2", GRID, 7, THERE, withdrawn=True)) == 0
    assert not atlas.submaps
    assert atlas.grid.known_count == 0
