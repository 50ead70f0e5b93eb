"""The runs of `robrain bench exploration`: a full stack or ideal motion explores a floor by a strategy."""

import math

import msgspec
import numpy as np

from robrain.algorithms.mapping.ray_cast import cast_rays_of
from robrain.algorithms.navigation.clearance import least_clearance_m
from robrain.algorithms.navigation.path_planning import distance_field
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.lab.bench.mapping.mapping_plan import errors_alone
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.wire.errors import RobrainError
from robrain.sim.errors import RunFailed
from robrain.sim.ideal.ideal_run import IdealResult, run_ideal
from robrain.sim.ideal.ideal_team import SPEED_M_S
from robrain.sim.lockstep.result import RunResult
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.maps.placement import Starts
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.time_use import TimeUse

STANDPOINT_M = 0.4
"""Distance between the places from which is looked."""
RAYS = 720
"""At 6 m they are 5 cm apart, the pitch of the finest maps."""
PERCENTILE = 95.0
NOBODY = np.empty((0, 3))


def sight_bound_s(plan: FloorPlan, start: Point2D, radius_m: float, range_m: float, speed_m_s: float) -> float:
    """The least time in which robots from `start`, however many there are, can have seen 95 % of the floor, in seconds.

    A place is seen first from where the path is shortest among all places with it in sight and in range; the 95th
    percentile of these path lengths over the floor, at top speed. Half a diagonal between standpoints is taken off.

    Args:
        plan: the floor.
        start: where the team starts, arena frame.
        radius_m: of each robot.
        range_m: of the lidars.
        speed_m_s: top speed.

    """
    reachable = plan.reachable([start], least_clearance_m(radius_m))
    at = np.array([plan.cell_of(start.x_m, start.y_m)], dtype=np.int64)
    field = distance_field(reachable, np.ones(reachable.shape, np.float32), at)
    away_m: Floats = field.astype(np.float64) * plan.resolution_m
    step = max(1, round(STANDPOINT_M / plan.resolution_m))
    rows, columns = np.nonzero(np.isfinite(away_m[::step, ::step]) & reachable[::step, ::step])
    seen_m = _seen_m(plan, np.stack([rows * step, columns * step], axis=1), away_m, range_m)
    lengths_m = seen_m[reachable]
    farthest_m = float(np.percentile(lengths_m[np.isfinite(lengths_m)], PERCENTILE))
    return max(0.0, farthest_m - STANDPOINT_M / math.sqrt(2.0)) / speed_m_s


def _seen_m(plan: FloorPlan, cells: np.ndarray, away_m: Floats, range_m: float) -> Floats:
    """Length of the shortest path to one of the cells that sees a cell, (rows, columns), metres; inf if none does."""
    height, width = plan.occupied.shape
    geometry = GridGeometry(plan.resolution_m, plan.origin_x_m, plan.origin_y_m, width, height)
    walls = plan.occupied.copy()  # writable: a read-only array would be copied for every look
    angles_rad = np.linspace(-math.pi, math.pi, RAYS, endpoint=False)
    along_m = np.arange(0.0, range_m, 0.7 * plan.resolution_m)
    x_m = along_m * np.cos(angles_rad)[:, np.newaxis]
    y_m = along_m * np.sin(angles_rad)[:, np.newaxis]
    seen_m = np.full((height, width), np.inf)
    for row, column in cells.tolist():
        place = geometry.center_of(row, column)
        ranges_m = cast_rays_of(walls, geometry, Pose2D(place.x_m, place.y_m, 0.0), angles_rad, range_m, NOBODY)
        is_seen = along_m < np.minimum(ranges_m, range_m)[:, np.newaxis]
        rows = ((place.y_m + y_m[is_seen] - plan.origin_y_m) / plan.resolution_m).astype(np.int64)
        columns = ((place.x_m + x_m[is_seen] - plan.origin_x_m) / plan.resolution_m).astype(np.int64)
        is_inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        rows, columns = rows[is_inside], columns[is_inside]
        seen_m[rows, columns] = np.minimum(seen_m[rows, columns], away_m[row, column])
    return seen_m


FULL, IDEAL = "full", "ideal"
MOTIONS = (FULL, IDEAL)
"""The whole stack, or points at top speed with exact poses (`sim/ideal/ideal_team.py`)."""
BOUND_PERCENTILE = 95.0
UNTIL = 0.99


class ExplorationCase(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    map: str
    path: str
    """Path of the map's YAML file; empty for a built-in scenario."""
    robots: int
    seed: int
    strategy: str
    motion: str
    """Of `MOTIONS`."""
    near: tuple[float, float] | None = None
    """Around which place the robots start, metres, arena frame; None: where the scenario has it, the same place for
    teams of all sizes."""
    revise_s: float | None = None
    """Period in which robots may be given another goal; None: as planning has it."""
    time_limit_s: float = 900.0
    with_sight: bool = False
    """Whether `sight_s` is computed, which takes some seconds."""

    def scenario(self) -> Scenario:
        """The scenario of the run (RobrainError if the map cannot be read)."""
        found = Scenario.from_map(self.path) if self.path else Scenario.builtin(self.map)
        policy = msgspec.structs.replace(found.planning, exploration=self.strategy)
        if self.revise_s is not None:
            policy = msgspec.structs.replace(policy, revise_s=self.revise_s)
        changes: dict[str, object] = {"planning": policy, "until_explored": UNTIL, "time_limit_s": self.time_limit_s}
        if self.near is not None:
            changes["near"] = Point2D(*self.near)
        return found.replace(robots=self.robots, seed=self.seed, starts=Starts.TOGETHER, **changes)


class ExplorationRun(msgspec.Struct, frozen=True, kw_only=True):
    """What a run took."""

    case: ExplorationCase
    why_not: str = ""
    """Why it could not be run; then the other fields are empty."""
    explored_percent_s: dict[int, float] = {}
    """Simulated time at which 90, 95 and 99 % were known; without those that were not reached."""
    explored_fraction: float = 0.0
    sim_time_s: float = 0.0
    bound_s: float = 0.0
    """No team can know 95 % before: `bound_s`."""
    sight_s: float | None = None
    """No team can have seen 95 % before, even one that knows the floor: `sight_bound_s`; None unless asked for."""
    distance_m: float = 0.0
    energy_j: float | None = None
    """None for ideal motion, which takes none."""
    explored_m2: float = 0.0
    overlap: float | None = None
    collisions: int = 0
    time_use: TimeUse = TimeUse()
    """Summed over the robots."""


def run_case(case: ExplorationCase) -> ExplorationRun:
    """Make one run; if it cannot be made, `why_not` gives the reason (RunFailed if its strategy fails)."""
    try:
        with errors_alone():
            return _ideal(case) if case.motion == IDEAL else _full(case)
    except RunFailed:
        raise
    except RobrainError as error:
        return ExplorationRun(case=case, why_not=str(error))


def bound_s(plan: FloorPlan, start: Point2D, radius_m: float, range_m: float, speed_m_s: float = SPEED_M_S) -> float:
    """The least time in which a team from `start` can know 95 % of the floor, in seconds.

    Somebody must come within the lidar's range of a place that is farther away by path than 95 % of the floor: the
    95th percentile of the path lengths less the range, at top speed.

    Args:
        plan: the floor.
        start: where the team starts, arena frame.
        radius_m: of each robot.
        range_m: of the lidars.
        speed_m_s: top speed.

    """
    reachable = plan.reachable([start], least_clearance_m(radius_m))
    at = np.array([plan.cell_of(start.x_m, start.y_m)], dtype=np.int64)
    away = distance_field(reachable, np.ones(reachable.shape, np.float32), at)[reachable]
    farthest_m = float(np.percentile(away[np.isfinite(away)], BOUND_PERCENTILE)) * plan.resolution_m
    return max(0.0, farthest_m - range_m) / speed_m_s


def _full(case: ExplorationCase) -> ExplorationRun:
    scenario = case.scenario()
    result = scenario.run()
    spent = [robot.time_use for robot in result.per_robot]
    run = _common(case, scenario, result)
    return msgspec.structs.replace(
        run,
        energy_j=result.energy_j,
        overlap=result.overlap,
        collisions=result.collisions,
        time_use=TimeUse(**{name: sum(getattr(one, name) for one in spent) for name in TimeUse.__struct_fields__}),
    )


def _ideal(case: ExplorationCase) -> ExplorationRun:
    scenario = case.scenario()
    result = run_ideal(scenario)
    driving_s = max(0.0, result.sim_time_s * case.robots - result.standing_s)
    run = _common(case, scenario, result)
    return msgspec.structs.replace(run, time_use=TimeUse(driving_s=driving_s, standing_s=result.standing_s))


def _common(case: ExplorationCase, scenario: Scenario, result: RunResult | IdealResult) -> ExplorationRun:
    """What both motions tell."""
    floor = _Floor(scenario)
    return ExplorationRun(
        case=case,
        explored_percent_s=result.explored_percent_s,
        explored_fraction=result.explored_fraction,
        sim_time_s=result.sim_time_s,
        bound_s=floor.bound_s,
        sight_s=floor.sight_s() if case.with_sight else None,
        distance_m=result.distance_m,
        explored_m2=result.explored_fraction * floor.area_m2,
    )


class _Floor:
    """What a scenario's robots can reach from their starts."""

    def __init__(self, scenario: Scenario) -> None:
        world, hardware = scenario.world(), scenario.hardware
        starts = [Point2D(robot.start.x_m, robot.start.y_m) for robot in world.robots]
        reachable = world.plan.reachable(starts, least_clearance_m(hardware.radius_m))
        self.area_m2 = float(reachable.sum()) * world.plan.resolution_m**2
        self.bound_s = bound_s(world.plan, starts[0], hardware.radius_m, hardware.lidar.range_max_m)
        self._sight = world.plan, starts[0], hardware.radius_m, hardware.lidar.range_max_m, SPEED_M_S

    def sight_s(self) -> float:
        """The least time in which robots that know the floor can have seen 95 % of it."""
        return sight_bound_s(*self._sight)
