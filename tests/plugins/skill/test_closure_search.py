from collections.abc import Iterable

import numpy as np
import pytest

from robrain.algorithms.slam.submap import SURFACE
from robrain.algorithms.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper.closures import ClosureFinder
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 128, 128)
MATE, OTHER = ("r2", 7), ("r3", 1)
MIDDLE = Pose2D(3.25, 3.25, 0.5)


def atlas_of(*keys: SubmapKey, occupied: int = 60, T_arena_local: Pose2D = IDENTITY, at: int = 0) -> SubmapAtlas:
    """Finished submaps of 6.4 × 6.4 m, whose first cell is (at, at)."""
    atlas = SubmapAtlas(GEOMETRY)
    for key in keys:
        cells = np.full((64, 64), FREE, np.int8)
        cells.ravel()[:occupied] = OCCUPIED
        atlas.merge(key, at, at, cells, 1)
        atlas.move(key, T_arena_local)
        atlas.set_surfaces(key, np.zeros(occupied, SURFACE))
    return atlas


def searching(atlas: SubmapAtlas, own: Iterable[int] = ()) -> ClosureFinder:
    graph = SubmapGraph("r1", GraphSpec())
    for number in own:
        graph.begin(number, IDENTITY, IDENTITY, 0, np.eye(3))
    return ClosureFinder("r1", graph, atlas, 0.0)


@pytest.mark.parametrize("at", [0, 32])
@pytest.mark.parametrize(
    ("x_m", "y_m", "is_inside"),
    [
        (1.55, 3.0, True),
        (1.45, 3.0, False),
        (4.95, 3.0, True),
        (5.05, 3.0, False),
        (3.0, 1.55, True),
        (3.0, 1.45, False),
        (3.0, 4.95, True),
        (3.0, 5.05, False),
    ],
)
def test_the_sensor_has_to_be_well_inside_the_submap_where_it_lies_now(
    at: int, x_m: float, y_m: float, is_inside: bool
) -> None:
    T_arena_local = Pose2D(2.0, -1.0, 0.7)
    search = searching(atlas_of(MATE, T_arena_local=T_arena_local, at=at))
    sensor = T_arena_local.compose(Pose2D(x_m + 0.1 * at, y_m + 0.1 * at, 1.0))
    assert (search.candidate(sensor) == MATE) == is_inside


def test_the_submap_that_is_being_made_and_the_one_before_are_left_out() -> None:
    own: list[SubmapKey] = [("r1", 1), ("r1", 2), ("r1", 3)]
    search = searching(atlas_of(*own), own=[1, 2, 3])
    assert search.candidate(MIDDLE) == ("r1", 1)
    assert search.candidate(MIDDLE) is None


def test_a_submap_is_tried_again_only_from_elsewhere() -> None:
    search = searching(atlas_of(MATE))
    assert search.candidate(Pose2D(2.0, 3.0, 0.0)) == MATE
    assert search.candidate(Pose2D(2.0, 3.0, 2.0)) is None
    assert search.candidate(Pose2D(2.69, 3.0, 0.0)) is None
    assert search.candidate(Pose2D(2.71, 3.0, 0.0)) == MATE
    assert search.candidate(Pose2D(2.0, 3.0, 0.0)) == MATE, "it was tried last from 0.71 m away"


def test_a_submap_that_was_never_tried_comes_first() -> None:
    atlas = atlas_of(MATE)
    search = searching(atlas)
    assert search.candidate(Pose2D(2.0, 3.0, 0.0)) == MATE
    for key, submap in atlas_of(OTHER, ("r4", 1)).submaps.items():
        atlas.submaps[key] = submap
    there = Pose2D(4.0, 3.0, 0.0)
    assert [search.candidate(there) for _ in range(4)] == [OTHER, ("r4", 1), MATE, None]
