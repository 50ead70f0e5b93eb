"""Compiling the map's kernels before a run, so that no step of the run pays for it."""

import numpy as np

from robrain.protocol.model.energy.power_learner import PowerLearner, PowerPrior
from robrain.protocol.model.energy.soc_filter import PackModel, SocFilter
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.localization.localiser import Localiser, LocaliserSpec
from robrain.protocol.model.localization.mote_relocalisation import Signals, find_robot
from robrain.protocol.model.localization.pose_filter import DriftModel, PoseFilter
from robrain.protocol.model.localization.rssi_ranging import PathLoss, RssiSample
from robrain.protocol.model.localization.scan_agreement import agreement
from robrain.protocol.model.localization.scan_match import (
    beam_ends,
    match_scan,
    points_in_view,
    search_scan,
    without_dropouts,
)
from robrain.protocol.model.mapping.map_accuracy import measure_map_accuracy
from robrain.protocol.model.mapping.occupancy_grid import GridGeometry, OccupancyGrid
from robrain.protocol.model.mapping.ray_cast import cast_rays
from robrain.protocol.model.navigation.clearance_kernels import clearance_m
from robrain.protocol.model.navigation.escape import escape_cells
from robrain.protocol.model.navigation.frontier import find_frontiers
from robrain.protocol.model.navigation.line_of_sight import standpoint
from robrain.protocol.model.navigation.navigation_grid import NavigationGrid, Zone
from robrain.protocol.model.navigation.obstacles import contact_distance_m, hold_off, passage, sector_distances_m
from robrain.protocol.model.navigation.path_planning import (
    descend,
    distance_field,
    nearest_traversable,
    plan_path,
    shorten_path,
)
from robrain.protocol.model.navigation.right_of_way import (
    Margins,
    Track,
    Way,
    any_within,
    meet,
    pass_on,
    release,
    sample_way,
    sample_ways,
)
from robrain.protocol.model.numeric.elementary_functions import arctan2, exp, log, log10
from robrain.protocol.model.numeric.small_linear_algebra import (
    innovation_squared,
    inverse,
    least_solution,
    quadratic_form,
)
from robrain.protocol.model.slam.map_overlap import MapMatcher
from robrain.protocol.model.slam.mates_in_scan import mate_circles, wall_ends
from robrain.protocol.model.slam.place_search import search_places
from robrain.protocol.model.slam.pose_graph import Edge, solve
from robrain.protocol.model.slam.submap import IDENTITY
from robrain.protocol.model.slam.submap_atlas import SubmapAtlas
from robrain.protocol.model.slam.surface_match import match_surface


def warm_up() -> None:
    """Call every kernel once with arrays of the types it meets in use.

    The first call on a computer compiles and stores the machine code beside the sources (some seconds); later
    processes load it (tenths of a second). Calling it again costs next to nothing.
    """
    battery = SocFilter(PackModel())
    battery.start_from(16.0, 0.5)
    battery.count(0.5, 0.2)
    battery.fuse(16.0, 0.5)
    battery.interval_j()

    geometry = GridGeometry(0.1, 0.0, 0.0, 8, 8)
    grid = OccupancyGrid(geometry)
    sensor = Pose2D(0.35, 0.35, 0.0)
    angles_rad = np.array([0.0, 1.0])
    circles = np.array([[0.6, 0.6, 0.05]])
    walls = np.zeros(geometry.shape, np.bool_)
    walls[:, 7] = True

    ranges_m = cast_rays(walls, geometry, sensor, angles_rad, 1.0, circles)
    points_m = np.stack((ranges_m, ranges_m))
    contact_distance_m(points_m, 0.0, 0.0, 0.0, 0.2)
    sector_distances_m(points_m, 0.0, 0.0, 0.0, 8)
    hold_off(points_m, 0.0, 0.0, 0.1, 0.1, 0.2, 0.02, 2.0)
    passage(points_m, 0.0, 0.0, 0.0, 0.2)
    grid.integrate_scan(sensor, angles_rad, ranges_m, 1.0, 0, circles)
    patch = grid.take_patch()
    if patch is not None:
        OccupancyGrid(geometry).merge_patch(patch.row, patch.column, patch.cells, patch.stamp_ms)
    find_frontiers(grid.classes(), ~walls)
    measure_map_accuracy(grid.classes(), geometry, walls, geometry)

    traversable = clearance_m(walls, geometry.resolution_m, 0.5) > 0
    cost = np.ones(geometry.shape, np.float32)
    start = nearest_traversable(traversable, (0, 7), 2) or (0, 0)
    path = plan_path(traversable, cost, start, (3, 0))
    if path is not None:
        shorten_path(path, traversable)
    descend(distance_field(traversable, cost, np.array([[3, 0]])), traversable, start)
    _warm_up_localisation(grid)
    _warm_up_mapping(geometry)
    _warm_up_giving_way(geometry)
    _warm_up_small_kernels()


def _warm_up_giving_way(geometry: GridGeometry) -> None:
    free = np.zeros(geometry.shape, np.int8)
    navigation = NavigationGrid(free, geometry, 0.1)
    positions = sample_way(np.array([[0.35, 0.35], [0.35, 0.6]]), 10.0)
    mate = Track(positions, 0.6, positions.shape[0] - 1, 0.1, goes_first=True)
    release(positions, 0.6, [mate], Margins())
    meet(positions, mate, 0.1)
    pass_on(sample_ways(positions, [len(positions)]), [0], positions[:1])
    Way(positions).ahead(0.35, 0.35, 1.0)
    any_within([mate], Point2D(0.0, 0.0), 1.0)
    escape_cells(navigation.traversable, geometry, (3, 3), 0.6, [mate], 0.1)
    standpoint(free, navigation.traversable, (3, 3), 2)
    navigation.path(Point2D(0.15, 0.15), Point2D(0.65, 0.45), snap_m=0.5, dear=[Zone(positions, 0.1)])
    navigation.clear_positions(free, positions)


def _warm_up_localisation(grid: OccupancyGrid) -> None:
    localiser = Localiser(Pose2D(0.4, 0.4, 0.0), 0.1, 0.2, LocaliserSpec())  # so unsure a yaw is split
    localiser.move(Twist2D(0.01, 0.0, 0.01))
    localiser.hear(RssiSample("m", Point2D(0.7, 0.7), -60.0))
    localiser.filter.correct((1.0, 0.0, 0.0), 0.0, 1.0)
    one = PoseFilter(localiser.pose, 0.1, 0.1, DriftModel(), PathLoss())
    one.correct((1.0, 0.0, 0.0), 0.0, 1.0)
    one.correct_along(np.eye(3), np.zeros(3), np.ones(3))
    ends = beam_ends(np.linspace(-3.0, 3.0, 30), np.full(30, 0.2), 1.0)
    match_scan(grid.log_odds, grid.geometry, localiser.pose, ends)
    points_in_view(grid.log_odds, grid.geometry, localiser.pose, ends)
    search_scan(grid.log_odds, grid.geometry, localiser.pose, ends, within_m=0.1, within_rad=0.05)
    agreement(grid.log_odds, grid.geometry, localiser.pose, ends)
    search_places(grid.log_odds, grid.geometry, ends, 4)
    MapMatcher(grid, grid).overlap(IDENTITY)
    _warm_up_finding_by_motes()


def _warm_up_mapping(geometry: GridGeometry) -> None:
    sensor, angles_rad = Pose2D(0.4, 0.4, 0.0), np.linspace(-3.0, 3.0, 30)
    ranges_m = 0.25 / np.maximum(np.abs(np.cos(angles_rad)), np.abs(np.sin(angles_rad)))
    circles = mate_circles(angles_rad, ranges_m, 1.0, sensor, np.array([[0.6, 0.6, 0.05]]))
    ends = wall_ends(angles_rad, ranges_m, 1.0, sensor, circles)
    own = OccupancyGrid(geometry, surfaces=True)
    own.integrate_scan(sensor, angles_rad, without_dropouts(ranges_m, 1.0, 4), 1.0, 0, circles)
    match_surface(own, sensor, ends)
    patch = own.take_patch()
    if patch is not None:
        atlas = SubmapAtlas(geometry)
        for stamp_ms in (patch.stamp_ms, patch.stamp_ms + 1):  # as a new submap, and as one that is known
            atlas.take(("r", 1), patch.row, patch.column, patch.cells, stamp_ms)
            atlas.move(("r", 1), sensor)
    solve([sensor], [IDENTITY], [Edge(1, sensor, 0, IDENTITY, np.eye(3), may_be_false=True)])


def _warm_up_finding_by_motes() -> None:
    places = np.array([[0.0, 0.0], [-1.0, 0.0], [-2.0, 1.0]]).repeat(3, axis=0)
    motes, mote_places = np.tile(np.arange(3), 3), np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
    distances_m = np.hypot(*(places + np.array([2.5, 1.0]) - mote_places[motes]).T)
    clear = PathLoss(shadowing_db=0.5, fading_db=0.1)  # so that the place is sure enough to be given
    rssi_dbm = clear.rssi_at_1_m_dbm - clear.db_per_e_fold * log(distances_m)
    find_robot(Signals(places, motes, mote_places, rssi_dbm), clear)


def _warm_up_small_kernels() -> None:
    ones, unit = np.ones(3), np.eye(3)
    innovation_squared(unit, unit, ones, ones)
    inverse(unit)
    least_solution(unit, ones)
    quadratic_form(unit, ones)
    PowerLearner(PowerPrior()).learn((1.0, 1.0, 0.5, 0.1, 0.0), 8.0)
    for function in (exp, log, log10):
        function(ones)
    arctan2(ones, ones)
