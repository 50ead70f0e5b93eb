import subprocess
import sys
from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

from robrain.algorithms.localization import mote_relocalisation, surface_match
from robrain.algorithms.mapping import occupancy_grid, ray_cast
from robrain.algorithms.navigation import frontier, path_planning, right_of_way
from robrain.algorithms.navigation import navigation_grid as navigation
from robrain.algorithms.numeric import small_linear_algebra
from robrain.algorithms.slam import pose_graph, robots_in_scan, submap, submap_atlas
from robrain.algorithms.warm_up import warm_up
from robrain.protocol.model import grid_geometry
from robrain.protocol.model.geometry import Point2D, Pose2D

pytestmark = pytest.mark.slow

MODULES: tuple[ModuleType, ...] = (
    frontier,
    robots_in_scan,
    occupancy_grid,
    path_planning,
    pose_graph,
    ray_cast,
    right_of_way,
    small_linear_algebra,
    submap,
    submap_atlas,
    surface_match,
)


def compiled() -> dict[str, int]:
    """How many variants of each kernel have been compiled or loaded."""
    return {
        name: len(kernel.signatures)
        for module in MODULES
        for name, kernel in vars(module).items()
        if isinstance(kernel, Dispatcher)
    }


def kernels_of(module: ModuleType) -> set[Dispatcher]:
    return {kernel for kernel in vars(module).values() if isinstance(kernel, Dispatcher)}


def use_every_kernel() -> None:
    # Whole numbers for metres, numpy integers for cells, and arrays off the wire, which cannot be written.
    geometry = grid_geometry.GridGeometry(1, 0, 0, 12, 10)
    grid = occupancy_grid.OccupancyGrid(geometry)
    sensor = Pose2D(5, 5, 0)
    angles_rad = np.frombuffer(np.linspace(-3, 3, 9))
    walls = np.zeros(geometry.shape, np.bool_)
    walls[8] = True
    walls.setflags(write=False)
    ranges_m = ray_cast.cast_rays(walls, geometry, sensor, angles_rad, 4, np.empty((0, 3)))
    ranges_m.setflags(write=False)
    grid.integrate_scan(sensor, angles_rad, ranges_m[::-1], 4, np.int64(7), np.empty((0, 3)))
    cells = np.frombuffer(bytes(6), np.int8).reshape(2, 3)
    grid.merge_patch(np.int64(1), np.int64(1), cells, np.int64(8))
    frontier.find_frontiers(grid.classes())
    traversable = navigation.clearance_m(walls, 1, 3) > 0
    traversable.setflags(write=False)
    cost = np.ones(geometry.shape, np.float32).T.copy().T
    start = path_planning.nearest_traversable(traversable, (np.int64(8), np.int64(3)), 2)
    assert start is not None
    path = path_planning.plan_path(traversable, cost, start, (np.int64(0), np.int64(0)))
    assert path is not None
    path_planning.shorten_path(path[::2], traversable)
    path_planning.distance_field(traversable, cost, np.array([[0, 0]], np.int32))
    use_every_kernel_of_giving_way()
    use_every_kernel_of_mapping(geometry, sensor, angles_rad, ranges_m, cells)
    square, vector = np.eye(4), np.ones(4)
    small_linear_algebra.innovation_squared(square, square, vector, vector)
    small_linear_algebra.inverse(np.eye(3, dtype=np.float32).T)
    small_linear_algebra.least_solution(square, vector)
    small_linear_algebra.quadratic_form(square, vector)


def use_every_kernel_of_giving_way() -> None:
    points = np.array([(0, 0), (3, 0)])
    right_of_way.DrivenPath(points).ahead(1, 0, 5)
    ways = [right_of_way.sample_path(points[:1], 5), right_of_way.sample_path(points, 5)]
    right_of_way.pass_on(ways, [0, 0], points)
    tracks = [right_of_way.Track(way, 1, 0, 1, goes_first=True) for way in ways]
    right_of_way.any_within(tracks, Point2D(1, 0), 2)
    right_of_way.release(ways[0], 1, tracks, right_of_way.Margins())
    right_of_way.meet(ways[0], tracks[0], 1)


def use_every_kernel_of_mapping(
    geometry: grid_geometry.GridGeometry,
    sensor: Pose2D,
    angles_rad: NDArray[np.float64],
    ranges_m: NDArray[np.float64],
    cells: NDArray[np.int8],
) -> None:
    own = occupancy_grid.OccupancyGrid(geometry, surfaces=True)
    told = np.array([(3, 3, 1), (5, 8, 1)])
    circles = robots_in_scan.robot_circles(angles_rad[::-1], ranges_m, 4, sensor, told)
    own.integrate_scan(sensor, angles_rad, ranges_m, 4, np.int64(7), circles, (0, 1))
    for left_out in (circles, np.empty((0, 3))):
        points = robots_in_scan.wall_ends(angles_rad[::-1], ranges_m, 4, sensor, left_out)
        surface_match.match_surface(own, sensor, points)
    atlas = submap_atlas.SubmapAtlas(geometry)
    atlas.merge(("r1", 1), np.int64(1), np.int64(1), cells, 8)
    atlas.merge(("r1", 1), 8, 8, cells, np.full((1, 1), 9, np.int32))
    atlas.merge(("r1", 1), np.int64(2), np.int64(2), cells, 10)
    atlas.move(("r1", 1), Pose2D(1, 0, 0))
    atlas.merge(("r1", 1), 2, 2, cells, 11)
    atlas.withdraw(("r1", 1))
    edge = pose_graph.Edge(1, Pose2D(1, 0, 0), 0, Pose2D(0, 0, 0), np.eye(3), may_be_false=False)
    pose_graph.solve([Pose2D(0, 0, 0)], [Pose2D(0, 0, 0)], [edge])
    pose_graph.solve([Pose2D(0, 0, 0)], [], [])


def test_no_kernel_is_left_to_compile_in_use_whatever_type_a_number_or_array_has() -> None:
    # In a process of its own: here, other tests have warmed the kernels up.
    subprocess.run([sys.executable, __file__], check=True, timeout=500)


def test_warming_up_calls_each_kernel_of_maps_paths_obstacles_and_motes(monkeypatch: pytest.MonkeyPatch) -> None:
    # As plain Python, so that it does not matter which kernels have been compiled already.
    called: set[Dispatcher] = set()

    def plain(kernel: Dispatcher) -> Callable[..., object]:
        def call(*arguments: object) -> object:
            called.add(kernel)
            return kernel.py_func(*arguments)

        return call

    others = (navigation, mote_relocalisation)
    needed = {kernel for module in (*MODULES, *others) for kernel in kernels_of(module)}
    models = [module for name, module in sys.modules.items() if name.startswith("robrain.algorithms.")]
    for module in models:
        for name, kernel in list(vars(module).items()):
            if isinstance(kernel, Dispatcher):
                monkeypatch.setattr(module, name, plain(kernel))
    warm_up()
    assert {kernel.py_func.__name__ for kernel in needed - called} == set()


if __name__ == "__main__":
    assert not any(compiled().values()), "importing the model compiled something"
    warm_up()
    warm = compiled()
    use_every_kernel()
    assert compiled() == warm, f"after the warm-up {warm}, in use {compiled()}"
