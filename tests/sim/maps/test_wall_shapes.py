import numpy as np
import pymunk
from hypothesis import given, settings
from hypothesis.extra import numpy as hnp

from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.maps.wall_shapes import add_walls, wall_rectangles

WALL = 7

grids = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=14))


def _next_to_free(occupied: np.ndarray) -> np.ndarray:
    """Occupied cells with a free one among their eight neighbours, found cell by cell."""
    wanted = np.zeros_like(occupied)
    for row, col in np.argwhere(occupied):
        window = occupied[max(0, row - 1) : row + 2, max(0, col - 1) : col + 2]
        wanted[row, col] = not window.all()
    return wanted


def _union(rectangles: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    union = np.zeros(shape, dtype=bool)
    for row0, col0, row1, col1 in rectangles:
        assert 0 <= row0 < row1 <= shape[0]
        assert 0 <= col0 < col1 <= shape[1]
        union[row0:row1, col0:col1] = True
    return union


# The first example may have to compile.
@settings(deadline=None)
@given(grids)
def test_rectangles_cover_the_walls_next_to_free_space_and_nothing_else(occupied: np.ndarray) -> None:
    rectangles = wall_rectangles(occupied)
    assert rectangles.dtype == np.int32
    assert rectangles.shape[1:] == (4,)
    np.testing.assert_array_equal(_union(rectangles, occupied.shape), _next_to_free(occupied))
    np.testing.assert_array_equal(rectangles, wall_rectangles(occupied.copy()))


def _plan() -> FloorPlan:
    occupied = np.zeros((30, 40), dtype=bool)
    occupied[10:20, 20:22] = True
    return FloorPlan(occupied, 0.1, -2.0, 1.0, "post")


def test_walls_stand_in_the_arena_frame_with_the_given_surface() -> None:
    space = pymunk.Space()
    shapes = add_walls(space, _plan(), collision_type=WALL, friction=0.5, elasticity=0.2)
    assert set(space.shapes) == set(shapes)
    for shape in shapes:
        assert shape.body is space.static_body
        assert (shape.collision_type, shape.friction, shape.elasticity) == (WALL, 0.5, 0.2)
    post = space.point_query_nearest((0.1, 2.5), 0.0, pymunk.ShapeFilter())
    assert post is not None
    assert post.shape in shapes
    assert space.point_query_nearest((-0.02, 2.5), 0.01, pymunk.ShapeFilter()) is None
    assert space.point_query_nearest((0.1, 1.98), 0.01, pymunk.ShapeFilter()) is None
