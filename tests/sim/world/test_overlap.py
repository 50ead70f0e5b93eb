"""How much floor several robots have seen."""

import numpy as np
import pytest

from robrain.algorithms.slam.submap import Submap
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import FREE, GridGeometry
from robrain.sim.world.referee import overlap

GEOMETRY = GridGeometry(0.1, -1.0, -1.0, 60, 40)


def submap(row: int, column: int, height: int, width: int, place: Pose2D = Pose2D(0.0, 0.0, 0.0)) -> Submap:  # noqa: B008
    one = Submap(place)
    one.merge(row, column, np.full((height, width), FREE, np.int8), 1)
    return one


def test_nothing_seen_has_no_overlap() -> None:
    assert overlap({}, GEOMETRY) == 0.0
    assert overlap({("r1", 1): Submap()}, GEOMETRY) == 0.0


def test_what_one_robot_sees_twice_is_no_overlap() -> None:
    assert overlap({("r1", 1): submap(0, 0, 10, 10), ("r1", 2): submap(0, 0, 10, 10)}, GEOMETRY) == 0.0


def test_what_two_robots_see_counts_once_more() -> None:
    both = {("r1", 1): submap(0, 0, 10, 10), ("r2", 1): submap(0, 5, 10, 10)}
    assert overlap(both, GEOMETRY) == pytest.approx(50 / 150)


def test_a_submap_counts_where_it_lies_in_the_arena() -> None:
    moved = submap(0, 0, 10, 10, Pose2D(1.0, 0.0, 0.0))
    assert overlap({("r1", 1): submap(0, 10, 10, 10), ("r2", 1): moved}, GEOMETRY) == pytest.approx(1.0)
