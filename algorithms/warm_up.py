"""Compiling the map's kernels before a run, so that no step of the run pays for it.

Each part calls the kernels of one subject with arrays of the types that they meet in use. The first call on a computer
compiles and stores the machine code beside the sources (some seconds); later processes load it.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.energy.consumption import PowerLearner, PowerPrior
from robrain.algorithms.energy.soc_filter import PackModel, SocFilter
from robrain.algorithms.localization.localiser import Localiser, LocaliserSpec
from robrain.algorithms.localization.mote_relocalisation import Signals, find_robot
from robrain.algorithms.localization.pose_filter import DriftModel, PoseFilter
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.localization.scan_match import (
    beam_ends,
    match_walls,
    points_in_view,
    search_scan,
    without_dropouts,
)
from robrain.algorithms.localization.surface_match import agreement, match_surface
from robrain.algorithms.mapping.map_accuracy import measure_map_accuracy
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.mapping.ray_cast import cast_rays
from robrain.algorithms.navigation.frontier import find_frontiers
from robrain.algorithms.navigation.navigation_grid import NavigationGrid, Swath, clearance_m
from robrain.algorithms.navigation.obstacles import contact_distance_m, hold_off, passage, sector_distances_m
from robrain.algorithms.navigation.path_planning import (
    distance_field,
    measured_field,
    nearest_traversable,
    plan_path,
    shorten_path,
    standpoint,
)
from robrain.algorithms.navigation.right_of_way import (
    DrivenPath,
    Margins,
    Track,
    any_within,
    escape_cells,
    meet,
    orders,
    pass_on,
    release,
    sample_path,
)
from robrain.algorithms.numeric.elementary_functions import arctan2, exp, log, log10
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.numeric.small_linear_algebra import innovation_squared, inverse, least_solution, quadratic_form
from robrain.algorithms.slam.map_overlap import MapMatcher, search_places
from robrain.algorithms.slam.pose_graph import Edge, solve
from robrain.algorithms.slam.robots_in_scan import robot_circles, wall_ends
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D, Twist2D
from robrain.protocol.model.grid_geometry import GridGeometry

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 8, 8)
CIRCLES = np.array([[0.6, 0.6, 0.05]])
SENSOR = Pose2D(0.4, 0.4, 0.0)


class KernelPart(NamedTuple):
    """A part of the kernels that is compiled at a time."""

    warm_up: Callable[[], None]
    at_start: bool
    """Whether an exploring team uses it within its first minute."""


def warm_up(*, only_at_start: bool = False) -> None:
    """Compile or load the kernels, all or those that a team uses at first. Again, it costs next to nothing."""
    for part in PARTS.values():
        if part.at_start or not only_at_start:
            part.warm_up()


def _battery() -> None:
    battery = SocFilter(PackModel())
    battery.start_from(16.0, 0.5)
    battery.count(0.5, 0.2)
    battery.fuse(16.0, 0.5)
    battery.interval_j()
    PowerLearner(PowerPrior()).learn((1.0, 1.0, 0.5, 0.1, 0.0), 8.0)


def _walls() -> NDArray[np.bool_]:
    walls = np.zeros(GEOMETRY.shape, np.bool_)
    walls[:, 7] = True
    return walls


def _scans() -> None:
    angles_rad = np.array([0.0, 1.0])
    _seen_grid(angles_rad, cast_rays(_walls(), GEOMETRY, SENSOR, angles_rad, 1.0, CIRCLES)).pop_patch()


def _glass() -> None:
    cast_rays(_walls(), GEOMETRY, SENSOR, np.array([0.0, 1.0]), 1.0, CIRCLES, echo_rad=0.1)


def _seen_grid(angles_rad: Floats, ranges_m: Floats) -> OccupancyGrid:
    grid = OccupancyGrid(GEOMETRY)
    grid.integrate_scan(SENSOR, angles_rad, ranges_m, 1.0, 0, CIRCLES)
    return grid


def _obstacles() -> None:
    points_m = np.full((2, 2), 0.5)
    contact_distance_m(points_m, 0.0, 0.0, 0.0, 0.2)
    sector_distances_m(points_m, 0.0, 0.0, 0.0, 8)
    hold_off(points_m, 0.0, 0.0, 0.1, 0.1, 0.2, 0.02, 2.0)
    passage(points_m, 0.0, 0.0, 0.0, 0.2)


def _frontiers() -> None:
    classes = OccupancyGrid(GEOMETRY).classes()
    find_frontiers(classes)
    measure_map_accuracy(classes, GEOMETRY, _walls(), GEOMETRY)


def _paths() -> None:
    traversable = clearance_m(_walls(), GEOMETRY.resolution_m, 0.5) > 0
    cost = np.ones(GEOMETRY.shape, np.float32)
    start = nearest_traversable(traversable, (0, 7), 2) or (0, 0)
    path = plan_path(traversable, cost, start, (3, 0))
    if path is not None:
        shorten_path(path, traversable)
    measured_field(distance_field(traversable, cost, np.array([[3, 0]])), traversable, cost, cost)


def _navigation_grid() -> None:
    free = np.zeros(GEOMETRY.shape, np.int8)
    navigation = NavigationGrid(free, GEOMETRY, 0.1)
    positions = sample_path(np.array([[0.35, 0.35], [0.35, 0.6]]), 10.0)
    standpoint(free, navigation.traversable, (3, 3), 2)
    for keeps_right in (False, True):
        ends = Point2D(0.15, 0.15), Point2D(0.65, 0.45)
        navigation.path(*ends, snap_m=0.5, dear=[Swath(positions, 0.1)], keeps_right=keeps_right)
    navigation.clear_positions(free, positions)


def _teammate() -> Track:
    positions = sample_path(np.array([[0.35, 0.35], [0.35, 0.6]]), 10.0)
    return Track(positions, 0.6, positions.shape[0] - 1, 0.1, goes_first=True)


def _right_of_way() -> None:
    teammate = _teammate()
    positions = teammate.positions
    release(positions, 0.6, [teammate], Margins())
    orders(sample_path(np.array([[0.35, 0.05], [0.35, 0.6]]), 10.0), [teammate], 0.1)
    meet(positions, teammate, 0.1)
    pass_on([positions], [0], positions[:1])
    DrivenPath(positions).ahead(0.35, 0.35, 1.0)
    any_within([teammate], Point2D(0.0, 0.0), 1.0)


def _escapes() -> None:
    navigation = NavigationGrid(np.zeros(GEOMETRY.shape, np.int8), GEOMETRY, 0.1)
    escape_cells(navigation.traversable, GEOMETRY, (3, 3), 0.6, [_teammate()], 0.1)


def _pose_filter() -> None:
    localiser = Localiser(SENSOR, 0.1, 0.2, LocaliserSpec())  # a yaw with this uncertainty is split
    localiser.move(Twist2D(0.01, 0.0, 0.01))
    localiser.receive(RssiSample("m", Point2D(0.7, 0.7), -60.0))
    localiser.filter.correct((1.0, 0.0, 0.0), 0.0, 1.0)
    one = PoseFilter(localiser.pose, 0.1, 0.1, DriftModel(), PathLoss())
    one.correct((1.0, 0.0, 0.0), 0.0, 1.0)
    one.correct_along(np.eye(3), np.zeros(3), np.ones(3))


def _matched() -> tuple[OccupancyGrid, Floats]:
    angles_rad = np.array([0.0, 1.0])
    return _seen_grid(angles_rad, np.full(2, 0.3)), beam_ends(np.linspace(-3.0, 3.0, 30), np.full(30, 0.2), 1.0)


def _scans_on_map() -> None:
    grid, ends = _matched()
    points_in_view(grid.log_odds, grid.geometry, SENSOR, ends)
    agreement(grid.log_odds, grid.geometry, SENSOR, ends)


def _scan_matches() -> None:
    grid, ends = _matched()
    match_walls(grid.log_odds, grid.geometry, SENSOR, ends)
    search_scan(grid.log_odds, grid.geometry, SENSOR, ends, within_m=0.1, within_rad=0.05)


def _place_search() -> None:
    grid, ends = _matched()
    search_places(grid.log_odds, grid.geometry, ends, 4)


def _map_overlap() -> None:
    grid, _ = _matched()
    MapMatcher(grid, grid).overlap(IDENTITY)


def _room() -> tuple[Floats, Floats, Floats]:
    angles_rad = np.linspace(-3.0, 3.0, 30)
    ranges_m = 0.25 / np.maximum(np.abs(np.cos(angles_rad)), np.abs(np.sin(angles_rad)))
    return angles_rad, ranges_m, robot_circles(angles_rad, ranges_m, 1.0, SENSOR, CIRCLES)


def _surface_match() -> None:
    angles_rad, ranges_m, circles = _room()
    ends = wall_ends(angles_rad, ranges_m, 1.0, SENSOR, circles)
    own = OccupancyGrid(GEOMETRY, surfaces=True)
    own.integrate_scan(SENSOR, angles_rad, without_dropouts(ranges_m, 1.0, 4), 1.0, 0, circles)
    match_surface(own, SENSOR, ends)


def _submaps() -> None:
    angles_rad, ranges_m, circles = _room()
    own = OccupancyGrid(GEOMETRY, surfaces=True)
    own.integrate_scan(SENSOR, angles_rad, ranges_m, 1.0, 0, circles)
    own.contradict(np.zeros((2, 2), np.int8), 3, 3)
    patch = own.pop_patch()
    if patch is not None:
        atlas = SubmapAtlas(GEOMETRY)
        for number, place in enumerate((IDENTITY, Pose2D(0.1, 0.0, 0.0), Pose2D(0.4, 0.4, 0.1))):  # shifted, turned
            atlas.move(("r", 1), place)
            atlas.merge(("r", 1), patch.row, patch.column, patch.cells, patch.stamp_ms + number)
        OccupancyGrid(GEOMETRY).merge_patch(patch.row, patch.column, patch.cells, patch.stamp_ms)


def _pose_graph() -> None:
    solve([SENSOR], [IDENTITY], [Edge(1, SENSOR, 0, IDENTITY, np.eye(3), may_be_false=True)])


def _finding_by_motes() -> None:
    places = np.array([[0.0, 0.0], [-1.0, 0.0], [-2.0, 1.0]]).repeat(3, axis=0)
    motes, mote_places = np.tile(np.arange(3), 3), np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
    distances_m = np.hypot(*(places + np.array([2.5, 1.0]) - mote_places[motes]).T)
    clear = PathLoss(shadowing_db=0.5, fading_db=0.1)  # so that the place is certain enough to be given
    rssi_dbm = clear.rssi_at_1_m_dbm - clear.db_per_e_fold * log(distances_m)
    find_robot(Signals(places, motes, mote_places, rssi_dbm), clear)


def _small_kernels() -> None:
    ones, unit = np.ones(3), np.eye(3)
    innovation_squared(unit, unit, ones, ones)
    inverse(unit)
    least_solution(unit, ones)
    quadratic_form(unit, ones)
    for function in (exp, log, log10):
        function(ones)
    arctan2(ones, ones)


PARTS: dict[str, KernelPart] = {
    "battery": KernelPart(_battery, at_start=True),
    "small kernels": KernelPart(_small_kernels, at_start=True),
    "pose filter": KernelPart(_pose_filter, at_start=True),
    "scans": KernelPart(_scans, at_start=True),
    "surface match": KernelPart(_surface_match, at_start=True),
    "paths": KernelPart(_paths, at_start=True),
    "pose graph": KernelPart(_pose_graph, at_start=True),
    "submaps": KernelPart(_submaps, at_start=True),
    "navigation grid": KernelPart(_navigation_grid, at_start=True),
    "frontiers": KernelPart(_frontiers, at_start=True),
    "giving way": KernelPart(_right_of_way, at_start=True),
    "scans on the map": KernelPart(_scans_on_map, at_start=True),
    "obstacles": KernelPart(_obstacles, at_start=True),
    "finding by motes": KernelPart(_finding_by_motes, at_start=True),
    "scan matches": KernelPart(_scan_matches, at_start=False),
    "place search": KernelPart(_place_search, at_start=False),
    "glass": KernelPart(_glass, at_start=False),
    "escapes": KernelPart(_escapes, at_start=False),
    "map overlap": KernelPart(_map_overlap, at_start=False),
}
"""All parts, those at the start first: two short ones, so that progress is soon seen, then the longest."""
