"""The referee: the share of the reachable floor that is known in the team's maps.

It receives the same patches that the robots send each other, so its map is the common knowledge of the team.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robrain.algorithms.localization.pose_accuracy import PoseAccuracyMeter
from robrain.algorithms.mapping.map_accuracy import measure_map_accuracy
from robrain.algorithms.navigation.clearance import least_clearance_m
from robrain.algorithms.slam.map_patch import in_own_time, merge_message
from robrain.algorithms.slam.submap import Submap
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.clock import NS_PER_S
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.model.geometry import Point2D, Pose2D, wrap_angle_rad
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.wire.endpoint import Endpoint
from robrain.recording.reader.map_server import TEAM_RESOLUTION_M
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.robot.robot_body import Body

PATCHES_A_STEP = 4096
EDGE_CELLS = 3
"""Width of the margin around the floor plan, for walls at its edge that are measured just outside it."""


def team_geometry(plan: FloorPlan, resolution_m: float = TEAM_RESOLUTION_M) -> GridGeometry:
    """The grid that a team in this arena maps on: it covers the plan and a margin of `EDGE_CELLS`."""
    width_m, height_m = plan.size_m
    return GridGeometry(
        resolution_m,
        plan.origin_x_m - EDGE_CELLS * resolution_m,
        plan.origin_y_m - EDGE_CELLS * resolution_m,
        # The slack keeps a size that is a whole number of cells from being rounded up.
        math.ceil(width_m / resolution_m - 1e-6) + 2 * EDGE_CELLS,
        math.ceil(height_m / resolution_m - 1e-6) + 2 * EDGE_CELLS,
    )


class Referee:
    """Merges all robots' patches and reports the explored share.

    Args:
        plan: the true floor.
        starts: starts of the robots, arena frame.
        clearance_m: least clearance of the robots, which decides their reachable area
            (`algorithms/navigation/clearance.py`).
        geometry: the team's grid; patches for another are ignored.
        endpoint: endpoint on which the patches arrive.

    """

    def __init__(
        self, plan: FloorPlan, starts: Sequence[Point2D], clearance_m: float, geometry: GridGeometry, endpoint: Endpoint
    ) -> None:
        self._atlas = SubmapAtlas(geometry)
        self.grid = self._atlas.grid
        """The team's map."""
        self._inbox = Inbox(PATCHES_A_STEP)
        self._weights = floor_weights(plan, starts, clearance_m, geometry)
        self._cell_m2 = plan.resolution_m**2
        self._total = int(self._weights.sum())
        self._fraction = 0.0
        self._version = self.grid.version
        self._clock = endpoint.clock
        endpoint.subscribe(self._inbox, ROBOT_MAP)

    @property
    def explored_fraction(self) -> float:
        """Share of the reachable floor's area whose team cell is known, 0 to 1, as of the last `step()`."""
        return self._fraction

    @property
    def submaps(self) -> Mapping[tuple[str, int], Submap]:
        """Map patches that each robot has published, by robot and number; read-only."""
        return self._atlas.submaps

    def unseen_m2(self) -> NDArray[np.float64]:
        """Area of reachable floor in each unknown cell of the team's grid: (H, W), square metres."""
        return np.where(self.grid.known(), 0.0, self._weights * self._cell_m2)

    def step(self) -> None:
        """Merge the patches that have arrived."""
        for received in self._inbox.drain():
            try:
                merge_message(self._atlas, in_own_time(received.message, self._clock.now_ns()))
            except ValueError:
                continue  # a patch that cannot be merged counts as not seen
        if self.grid.version != self._version and self._total:
            self._version = self.grid.version
            self._fraction = int(self._weights[self.grid.known()].sum()) / self._total


def floor_weights(
    plan: FloorPlan, starts: Sequence[Point2D], clearance_m: float, geometry: GridGeometry
) -> NDArray[np.int64]:
    """(H, W) of the team's grid: the number of the plan's cells in each that robots from `starts` can reach."""
    return _cells_per_team_cell(plan, plan.reachable(list(starts), clearance_m), geometry)


def _cells_per_team_cell(plan: FloorPlan, mask: NDArray[np.bool_], geometry: GridGeometry) -> NDArray[np.int64]:
    """(H, W) of the team's grid: how many of the plan's marked cells have their centre in each cell."""
    rows, columns = np.nonzero(mask)
    # Both grids start at the plan's origin; the slack keeps centres that lie on a border on one side of it.
    scale = plan.resolution_m / geometry.resolution_m
    team_rows = np.floor(
        (rows + 0.5) * scale + (plan.origin_y_m - geometry.origin_y_m) / geometry.resolution_m + 1e-9
    ).astype(np.int64)
    team_columns = np.floor(
        (columns + 0.5) * scale + (plan.origin_x_m - geometry.origin_x_m) / geometry.resolution_m + 1e-9
    ).astype(np.int64)
    within = (team_rows >= 0) & (team_rows < geometry.height) & (team_columns >= 0) & (team_columns < geometry.width)
    flat = team_rows[within] * geometry.width + team_columns[within]
    return np.bincount(flat, minlength=geometry.width * geometry.height).reshape(geometry.shape)


TRUE_POSE_PERIOD_S = 0.1
"""Seconds between two stored true poses; between them, poses are interpolated."""
KEPT_TRUE_POSES = 30
"""Number of true poses kept, three seconds: a state that arrives later is not compared."""
STATES = 1024
"""Room in the inbox for states of robots that are not the arena's."""
MAP_PERIOD_STEPS = 5
"""Calls of `step` from one measurement of the map to the next."""


class AccuracyMeter:
    """Measures the accuracy of the team's poses and map.

    Call `keep()` every `TRUE_POSE_PERIOD_S`, and `step()` five times a second.

    Args:
        robots: names, in the order of `bodies`.
        bodies: the simulated bodies, with the true poses.
        referee: keeps the team's map.
        walls: bool (H, W), the true walls.
        geometry: grid of the walls, arena frame.
        endpoint: receives the robots' states; its clock must be that of their stamps.

    """

    def __init__(
        self,
        robots: Sequence[str],
        bodies: Sequence[Body],
        referee: Referee,
        walls: NDArray[np.bool_],
        geometry: GridGeometry,
        endpoint: Endpoint,
    ) -> None:
        self._bodies = bodies
        self._referee = referee
        self._walls, self._geometry = walls, geometry
        self._clock = endpoint.clock
        self._meters = {name: PoseAccuracyMeter() for name in robots}
        self._index = {name: index for index, name in enumerate(robots)}
        self._true: deque[tuple[int, list[tuple[float, float, float]]]] = deque(maxlen=KEPT_TRUE_POSES)
        """Stamp, and x, y, yaw of each robot; the yaw is not wrapped."""
        self._inbox = Inbox(STATES + len(robots))
        self.at_task = [False] * len(bodies)
        """Whether each robot had a task in its last received state, in the order of `bodies`."""
        self._steps = 0
        self._map_version = -1
        self._map_accuracy: MapAccuracy | None = None
        endpoint.subscribe(self._inbox, ROBOT_STATE)

    @property
    def map_accuracy(self) -> MapAccuracy | None:
        """Accuracy of the team's map at the last measurement; None before the first."""
        return self._map_accuracy

    def pose_accuracy(self, robot: str) -> PoseAccuracy:
        """Accuracy of a robot's poses at the last `step()` (KeyError: no such robot)."""
        return self._meters[robot].accuracy

    def keep(self) -> None:
        """Store the current true poses."""
        poses = [(body.x_m, body.y_m, body.yaw_rad) for body in self._bodies]
        self._true.append((self._clock.now_ns(), poses))

    def step(self) -> None:
        """Compare the states received since the last call; measure the map if it is due."""
        for received in self._inbox.drain():
            self._compare(received.message)
        if self._steps % MAP_PERIOD_STEPS == 0:
            self.measure_map()
        self._steps += 1

    def measure_map(self) -> None:
        """Compare the map with the true walls, if it has changed."""
        grid = self._referee.grid
        if grid.version != self._map_version:
            self._map_version = grid.version
            self._map_accuracy = measure_map_accuracy(grid.classes(), grid.geometry, self._walls, self._geometry)

    def _compare(self, state: RobotState) -> None:
        index = self._index.get(state.robot)
        if index is None:
            return
        self.at_task[index] = state.task is not None and not state.task.state.ended
        if state.pose is None:
            return
        true = self._true_pose(index, state.stamp_ns)
        if true is not None:
            time_s = state.stamp_ns / NS_PER_S
            self._meters[state.robot].add(time_s, state.pose, state.pose_covariance, state.lost, true)

    def _true_pose(self, index: int, stamp_ns: int) -> Pose2D | None:
        """T_arena_robot at a time; None before the first pose kept, or more than a period after the last."""
        later_ns, later = 0, None
        for kept_ns, poses in reversed(self._true):
            if kept_ns <= stamp_ns:
                if later is None and stamp_ns - kept_ns > TRUE_POSE_PERIOD_S * NS_PER_S:
                    return None
                share = (stamp_ns - kept_ns) / (later_ns - kept_ns) if later is not None else 0.0
                x_m, y_m, yaw_rad = poses[index]
                if later is not None and share > 0:
                    x_m += share * (later[0] - x_m)
                    y_m += share * (later[1] - y_m)
                    yaw_rad += share * (later[2] - yaw_rad)
                return Pose2D(x_m, y_m, wrap_angle_rad(yaw_rad))
            later_ns, later = kept_ns, poses[index]
        return None


def overlap(submaps: Mapping[tuple[str, int], Submap], geometry: GridGeometry) -> float:
    """Area that each robot has seen, summed over the robots, over the area that any has seen, less one.

    0: no cell was seen by two robots; 1: each cell by two on average. Cells are put where the team's map has them,
    to the nearest cell.

    Args:
        submaps: by robot and number.
        geometry: of the team's map.

    """
    seen: dict[str, np.ndarray] = {}
    for (robot, _number), submap in submaps.items():
        rows, columns = np.nonzero(submap.evidence)
        x_m = geometry.origin_x_m + (columns + submap.column + 0.5) * geometry.resolution_m
        y_m = geometry.origin_y_m + (rows + submap.row + 0.5) * geometry.resolution_m
        place = submap.T_arena_local
        cos, sin = np.cos(place.yaw_rad), np.sin(place.yaw_rad)
        at_x_m, at_y_m = place.x_m + cos * x_m - sin * y_m, place.y_m + sin * x_m + cos * y_m
        column = np.floor((at_x_m - geometry.origin_x_m) / geometry.resolution_m).astype(np.int64)
        row = np.floor((at_y_m - geometry.origin_y_m) / geometry.resolution_m).astype(np.int64)
        within = (row >= 0) & (row < geometry.height) & (column >= 0) & (column < geometry.width)
        mask = seen.setdefault(robot, np.zeros(geometry.shape, np.bool_))
        mask[row[within], column[within]] = True
    if not seen:
        return 0.0
    masks = np.array(list(seen.values()))
    any_seen = int(masks.any(axis=0).sum())
    return int(masks.sum()) / any_seen - 1.0 if any_seen else 0.0


LEAST_AREA_M2 = 0.5
"""Smaller regions are not reported."""
MAX_REGIONS = 20
GAP_STEPS = 40
"""Steps, from the width that robots need down to 0, in which a gap's width is searched."""


class NotSeen(msgspec.Struct, frozen=True, kw_only=True, tag_field="code", tag="not_seen"):
    """Robots can get there but have not seen it."""


class GapTooNarrow(msgspec.Struct, frozen=True, kw_only=True, tag_field="code", tag="gap_too_narrow"):
    """Even the widest path there has a gap too narrow for the robots; the referee does not count this floor."""

    gap_m: float
    """Width of the gap, to within half a cell of the plan."""
    needed_m: float


class FloorLeft(msgspec.Struct, frozen=True, kw_only=True):
    """A region of floor that the team's maps do not cover, or that no robot can reach."""

    place: Point2D
    """The point of the region farthest from its edge, arena frame."""
    area_m2: float
    why: NotSeen | GapTooNarrow

    @property
    def words(self) -> str:
        """A sentence for people."""
        where = f"{self.area_m2:.1f} m² of floor about x {self.place.x_m:.1f}, y {self.place.y_m:.1f}"
        match self.why:
            case NotSeen():
                return f"{where} can be reached and has not been seen"
            case GapTooNarrow(gap_m=gap_m, needed_m=needed_m):
                return f"{where} cannot be reached: the way there is {gap_m:.2f} m wide, robots need {needed_m:.2f} m"


def floor_left(plan: FloorPlan, starts: list[Point2D], radius_m: float, referee: Referee) -> list[FloorLeft]:
    """The regions that a run left, largest first: at most `MAX_REGIONS`, none below `LEAST_AREA_M2`.

    Args:
        plan: the true floor.
        starts: starts of the robots, arena frame.
        radius_m: radius of the robots.
        referee: holds their observations.

    """
    found = [*_not_seen(referee), *_sealed(plan, starts, least_clearance_m(radius_m))]
    found = [left for left in found if left.area_m2 >= LEAST_AREA_M2]
    return sorted(found, key=lambda left: (-left.area_m2, left.place.x_m, left.place.y_m))[:MAX_REGIONS]


def _not_seen(referee: Referee) -> list[FloorLeft]:
    geometry = referee.grid.geometry
    area_m2 = referee.unseen_m2()
    labels, count = ndimage.label(area_m2 > 0)
    return [
        FloorLeft(
            place=geometry.center_of(*_middle(labels == label)),
            area_m2=round(float(area_m2[labels == label].sum()), 2),
            why=NotSeen(),
        )
        for label in range(1, count + 1)
        if float(area_m2[labels == label].sum()) >= LEAST_AREA_M2
    ]


def _sealed(plan: FloorPlan, starts: list[Point2D], needed_m: float) -> list[FloorLeft]:
    """Regions that have room for a robot but can only be reached through gaps too narrow for it."""
    labels, _ = ndimage.label(~plan.occupied & (plan.clearance_m >= needed_m))
    cells = [cell for start in starts if plan.geometry.contains(*(cell := plan.geometry.cell_of(start.x_m, start.y_m)))]
    held = {int(labels[cell]) for cell in cells} - {0}
    left = {int(label) for label in np.unique(labels)} - held - {0}
    found: list[FloorLeft] = []
    for step in range(1, GAP_STEPS + 1):
        if not left:
            break
        clearance_m = needed_m * (1.0 - step / GAP_STEPS)
        wider, _ = ndimage.label(~plan.occupied & (plan.clearance_m >= clearance_m))
        roamed = np.isin(wider, sorted({int(wider[cell]) for cell in cells} - {0}))
        for label in sorted(left):
            region = labels == label
            if roamed[region].any():
                left.discard(label)
                swept = ndimage.distance_transform_edt(~region) * plan.resolution_m <= needed_m
                found.append(
                    FloorLeft(
                        place=plan.geometry.center_of(*_middle(region)),
                        area_m2=round(float((swept & ~plan.occupied).sum()) * plan.resolution_m**2, 2),
                        why=GapTooNarrow(
                            gap_m=round(2.0 * clearance_m + 0.5 * plan.resolution_m, 2),
                            needed_m=round(2.0 * needed_m, 2),
                        ),
                    )
                )
    return found


def _middle(region: NDArray[np.bool_]) -> tuple[int, int]:
    """The cell (row, column) of a region that is farthest from its edge."""
    depth = ndimage.distance_transform_edt(np.pad(region, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return int(row), int(column)
