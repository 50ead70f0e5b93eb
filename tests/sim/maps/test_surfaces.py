"""Which walls of a floor become glass and mirrors."""

import math

import numpy as np
import pytest

from robrain.algorithms.mapping.ray_cast import (
    GLASS_X,
    GLASS_Y,
    MIRROR_EAST,
    MIRROR_NORTH,
    MIRROR_SOUTH,
    MIRROR_WEST,
    SOLID,
)
from robrain.protocol.model.geometry import Pose2D
from robrain.sim.maps.drawing import Block, FloorDrawing, Wall, rasterise
from robrain.sim.maps.surfaces import FloorSurfaces, SurfaceSpec

GLASS = GLASS_X | GLASS_Y
MIRRORS = MIRROR_WEST | MIRROR_EAST | MIRROR_SOUTH | MIRROR_NORTH
PLAN = rasterise(
    FloorDrawing(
        size_m=(20.0, 12.0),
        walls=(Wall((4.0, 6.0), (16.0, 6.0)), Wall((10.0, 2.0), (10.0, 5.0)), Wall((2.0, 8.0), (6.0, 11.0))),
        blocks=(Block(13.0, 8.0, 3.0, 1.2),),
    ),
    "rooms",
)


def drawn(seed=1, **spec):
    return FloorSurfaces.draw(SurfaceSpec(**spec), PLAN, seed).cells


@pytest.mark.slow
def test_walls_stay_where_they_are_whatever_they_are_made_of():
    cells = drawn(glass_share=0.4, mirror_share=0.4)
    assert np.array_equal(cells != 0, PLAN.occupied)
    assert (cells[PLAN.occupied] & SOLID).all()


def test_all_of_it_is_the_straight_thin_walls_each_with_its_normal():
    cells = drawn(glass_share=1.0)
    assert (cells[119:121, 100:195] == SOLID | GLASS_Y).all()
    assert (cells[42:98, 199:201] == SOLID | GLASS_X).all()
    assert (cells[5:235, :2] == SOLID | GLASS_X).all()
    assert (cells[:2, 5:395] == SOLID | GLASS_Y).all()
    assert (cells[160:184, 260:320] == SOLID).all(), "a block is too thick"
    slanting = cells[165:215, 50:110]
    assert (slanting[slanting != 0] == SOLID).all()


def test_mirrors_are_sides_that_face_the_floor():
    cells = drawn(mirror_share=1.0)
    block = cells[160:184, 260:320]
    assert (block[0, 1:-1] == SOLID | MIRROR_SOUTH).all()
    assert (block[-1, 1:-1] == SOLID | MIRROR_NORTH).all()
    assert (block[1:-1, 0] == SOLID | MIRROR_WEST).all()
    assert (block[1:-1, -1] == SOLID | MIRROR_EAST).all()
    assert (block[1:-1, 1:-1] == SOLID).all()


@pytest.mark.parametrize(("kind", "mask"), [("glass_share", GLASS), ("mirror_share", MIRRORS)])
@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_about_the_share_that_is_wanted_is_drawn(kind, mask, share):
    whole = np.count_nonzero(drawn(**{kind: 1.0}) & mask)
    drawn_share = np.count_nonzero(drawn(**{kind: share}) & mask) / whole
    assert drawn_share == pytest.approx(share, abs=0.06)


def test_pane_of_a_floor_is_seen_through_at_a_slant():
    surfaces = FloorSurfaces.draw(SurfaceSpec(glass_share=1.0), PLAN, 1)
    angles_rad = np.array([math.pi / 2, math.pi / 2 - 0.4])
    straight_m, slanting_m = surfaces.cast(Pose2D(12.0, 4.0, 0.0), angles_rad, 6.0, np.empty((0, 3))).tolist()
    assert straight_m == pytest.approx(1.9, abs=0.06)
    assert slanting_m == pytest.approx(4.0 / math.cos(0.4), abs=0.1), "the block behind the pane"
