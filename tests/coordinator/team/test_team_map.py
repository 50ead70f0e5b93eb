import zlib

import msgspec
import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

GEOMETRY = GridGeometry(0.1, -1.0, -1.0, 40, 30)


def patch(robot="r1", geometry=GEOMETRY, *, row=2, column=3, shape=(4, 5), kind=FREE, stamp_ms=100):
    return to_message(robot, geometry, PatchCells(row, column, np.full(shape, kind, np.int8), stamp_ms))


def test_the_first_patch_says_which_grid_the_team_maps_on():
    team_map = TeamMap()
    team_map.merge(patch())
    assert team_map.grid.geometry == GEOMETRY
    assert team_map.known_area_m2 == pytest.approx(0.2)
    classes = team_map.grid.classes()
    assert (classes[2, 3], classes[5, 7], classes[6, 3]) == (FREE, FREE, UNKNOWN)


def test_the_later_word_on_a_cell_counts_whatever_the_order():
    maps = [TeamMap(), TeamMap()]
    words = [patch("r1", kind=OCCUPIED, stamp_ms=100), patch("r2", kind=FREE, stamp_ms=200)]
    for team_map, order in zip(maps, (words, words[::-1]), strict=True):
        for word in order:
            team_map.merge(word)
        assert team_map.grid.classes()[2, 3] == FREE


@pytest.mark.parametrize(
    "geometry",
    [
        GridGeometry(0.05, -1.0, -1.0, 40, 30),
        GridGeometry(0.1, -1.1, -1.0, 40, 30),
        GridGeometry(0.1, -1.0, -1.0, 41, 30),
    ],
)
def test_patches_on_another_grid_are_refused_in_words_and_change_nothing(geometry):
    team_map = TeamMap()
    assert team_map.merge(patch("r1")) == ""
    version = team_map.version
    for robot in ("r2", "r3"):
        assert f"the map of {robot} cannot be merged" in team_map.merge(patch(robot, geometry, row=10))
    assert (team_map.version, team_map.grid.geometry) == (version, GEOMETRY)


BROKEN = {
    "cells that do not inflate": {"cells": b"no zlib"},
    "too few cells": {"rows": 5},
    "a box wider than any submap": {"rows": 1, "columns": 5000, "cells": zlib.compress(bytes(5000))},
    "a box far beyond the grid": {"row": 2800},
    "a negative box": {"rows": -4, "columns": -5},
    "a grid without size": {"width": 0},
    "a grid of no resolution": {"resolution_m": 0.0},
    "a grid that no memory holds": {"width": 10_000_000, "height": 10_000_000},
    "times of tiles that are later than the patch": {"tiles_ms": zlib.compress(b"\x7f" * 8)},
}


@pytest.mark.parametrize("changes", BROKEN.values(), ids=BROKEN)
def test_a_broken_patch_is_refused_and_changes_nothing_nor_says_which_grid_the_team_maps_on(changes):
    team_map = TeamMap()
    broken = msgspec.structs.replace(patch("r2"), **changes)
    assert team_map.merge(broken).startswith("the map of r2 cannot be merged")
    assert team_map.grid is None
    team_map.merge(patch("r1"))
    version, classes = team_map.version, team_map.grid.classes().copy()
    assert team_map.merge(broken).startswith("the map of r2 cannot be merged")
    assert (team_map.version, team_map.known_area_m2) == (version, pytest.approx(0.2))
    assert np.array_equal(team_map.grid.classes(), classes)


def test_patches_that_are_held_are_taken_in_when_they_are_released_and_not_before():
    held, straight = TeamMap(), TeamMap()
    held.hold()
    for word in (patch("r1"), patch("r2", row=10, kind=OCCUPIED), patch("r1", geometry=GridGeometry(0.2, 0, 0, 9, 9))):
        held.merge(word)
        straight.merge(word)
        assert (held.grid, held.version, held.known_area_m2) == (None, 0, 0.0)
    ((robot, why),) = held.release()
    assert (robot, why[: len("the map of r1 cannot be merged")]) == ("r1", "the map of r1 cannot be merged")
    assert np.array_equal(held.grid.classes(), straight.grid.classes())
    assert held.known_area_m2 == straight.known_area_m2
    held.merge(patch("r3", row=20))
    assert held.known_area_m2 == pytest.approx(0.6)
