"""Coverage of an area: by lanes that a robot drives, or by the view from one place.

Lanes follow the boustrophedon decomposition (H. Choset, Coverage of Known Spaces: The Boustrophedon Cellular
Decomposition, Autonomous Robots 9, 2000). Obstacles cut parallel lanes into runs. A strip ends where a run splits or
runs join, so a robot can drive each strip to and fro without a detour.
"""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.mapping.zone_grid import cells_in
from robrain.algorithms.navigation.frontier import touching
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from robrain.protocol.model.zone import Zone, ZoneKind

Lane = tuple[Point2D, Point2D]
"""Start and end, arena frame."""
Strip = list[Lane]
"""Neighbouring lanes, all in the same direction."""
PathLengths = Callable[[Point2D, Sequence[Point2D]], Sequence[float]]
"""Lengths in metres of the paths from a place to others; inf where there is none."""
VIEWED_MAX = 200
VIEWPOINTS_MAX = 150
"""Largest numbers of viewed cells and of places that are compared; of more cells, evenly drawn ones."""


def floor_of(area: Sequence[Point2D], ground: NDArray[np.bool_], geometry: GridGeometry) -> NDArray[np.bool_]:
    """Mask (H, W) of the ground's cells in an area; corners in the arena frame."""
    corners_m = tuple((corner.x_m, corner.y_m) for corner in area)
    return ground & cells_in(Zone(name="area", kind=ZoneKind.PLACE, corners_m=corners_m), geometry)


def lanes_over(
    area: Sequence[Point2D], floor: NDArray[np.bool_], geometry: GridGeometry, width_m: float
) -> list[Strip]:
    """Lanes over the floor (H, W) of an area, at most `width_m` apart, by strips.

    They run along its longest side or across it, whichever needs fewer lanes. Floor beside
    obstacles that they do not cover gets more lanes.
    """
    ends = [*area[1:], area[0]]
    start, end = max(zip(area, ends, strict=True), key=lambda side: side[0].distance_m(side[1]))
    yaw_rad = math.atan2(end.y_m - start.y_m, end.x_m - start.x_m)
    directions_rad = (yaw_rad, yaw_rad + math.pi / 2)
    found = [_cells(floor, geometry, direction_rad, width_m, width_m) for direction_rad in directions_rad]
    found = [[lanes for lanes in cells if _length_m(lanes[0]) >= width_m / 2] for cells in found]
    strips = min((strips for strips in found if strips), key=lambda strips: sum(map(len, strips)), default=[])
    slots, count = touching(floor & ~_covered(floor, geometry, strips, width_m), corners=True)
    for slot in range(1, count + 1):
        found = [_lanes_in_slot(slots == slot, geometry, direction_rad, width_m) for direction_rad in directions_rad]
        added: list[Strip] = min((lanes for lanes in found if lanes), key=len, default=[])
        strips += added
    return strips


def ordered_lanes(strips: Sequence[Strip], start: Point2D, path_lengths: PathLengths) -> list[Lane]:
    """All lanes in the order and direction in which to drive them: each time the strip with the nearest end.

    Strips to which no path leads are left out.
    """
    rest, lanes, place = list(strips), list[Lane](), start
    while rest:
        entries = [
            (strip, lane, end)
            for strip in range(len(rest))
            for lane in dict.fromkeys((0, len(rest[strip]) - 1))
            for end in (0, 1)
        ]
        lengths_m = path_lengths(place, [rest[strip][lane][end] for strip, lane, end in entries])
        best = min(range(len(entries)), key=lengths_m.__getitem__)
        if math.isinf(lengths_m[best]):
            break
        strip, lane, end = entries[best]
        chosen = rest.pop(strip)
        for number, (near, far) in enumerate(chosen if lane == 0 else reversed(chosen)):
            lanes.append((near, far) if (number + end) % 2 == 0 else (far, near))
        place = lanes[-1][1]
    return lanes


def covered_share(floor: NDArray[np.bool_], geometry: GridGeometry, driven: Floats, width_m: float) -> float:
    """Share of the floor (H, W) within half a working width, and a cell, of driven positions (N, 2), metres."""
    places = centres_of(floor, geometry)
    if not len(places):
        return 1.0
    reach_m = width_m / 2 + geometry.resolution_m
    near = np.zeros(len(places), np.bool_)
    for position in driven:
        near |= np.hypot(*(places - position).T) <= reach_m
    return float(near.mean())


def overlook(
    classes: NDArray[np.int8],
    traversable: NDArray[np.bool_],
    geometry: GridGeometry,
    area: Sequence[Point2D],
    within_m: float,
) -> tuple[Point2D, float] | None:
    """The place from which most of an area's free floor is seen, and that share; None if none of it is seen.

    Args:
        classes: (H, W), classes of an OccupancyGrid.
        traversable: (H, W), where the robot can stand.
        geometry: of the grid.
        area: corners, arena frame.
        within_m: range of view.

    """
    viewed = _some(np.argwhere(floor_of(area, classes == FREE, geometry)), VIEWED_MAX)
    viewpoints = np.argwhere(traversable)
    if not len(viewed):
        return None
    reach = within_m / geometry.resolution_m
    middle = viewed.mean(axis=0)
    viewpoints = _some(viewpoints[np.hypot(*(viewpoints - middle).T) <= reach], VIEWPOINTS_MAX)
    steps = np.linspace(0.0, 1.0, max(2, 2 * math.ceil(reach)))[:, np.newaxis, np.newaxis]
    counts = np.zeros(len(viewpoints), np.int64)
    for number, viewpoint in enumerate(viewpoints):
        ends = viewed[np.hypot(*(viewed - viewpoint).T) <= reach]
        rows, columns = np.floor(viewpoint + steps * (ends - viewpoint) + 0.5).astype(np.int64).transpose(2, 0, 1)
        counts[number] = np.count_nonzero((classes[rows, columns] != OCCUPIED).all(axis=0))
    if not counts.any():
        return None
    # Of places that see equally much, the nearest to the area's middle.
    best = np.lexsort((np.hypot(*(viewpoints - middle).T), -counts))[0]
    return geometry.center_of(*map(int, viewpoints[best])), float(counts[best] / len(viewed))


def centres_of(floor: NDArray[np.bool_], geometry: GridGeometry) -> Floats:
    """Centres (N, 2) of the cells of a mask (H, W), metres, arena frame."""
    cells = np.argwhere(floor)[:, ::-1] + 0.5
    return np.asarray(cells * geometry.resolution_m + (geometry.origin_x_m, geometry.origin_y_m), np.float64)


def _some(cells: NDArray[np.int64], at_most: int) -> NDArray[np.int64]:
    return cells[:: max(1, math.ceil(len(cells) / at_most))]


def _lanes_in_slot(
    slot: NDArray[np.bool_], geometry: GridGeometry, direction_rad: float, width_m: float
) -> list[Strip]:
    """Strips of a slot: lanes in a direction, or one along the middle of a part that is narrower."""
    strips: list[Strip] = []
    for lines in _cells(slot, geometry, direction_rad, width_m, geometry.resolution_m):
        extent_m = len(lines) * geometry.resolution_m
        if _length_m(lines[0]) >= width_m / 2:
            count = math.ceil(extent_m / width_m)
            strips.append([lines[int((lane + 0.5) / count * len(lines))] for lane in range(count)])
        elif extent_m >= width_m / 2:
            strips.append([(_middle(lines[0]), _middle(lines[-1]))])
    return strips


def _covered(
    floor: NDArray[np.bool_], geometry: GridGeometry, strips: Sequence[Strip], width_m: float
) -> NDArray[np.bool_]:
    """Mask (H, W) of the floor within half a working width of a lane."""
    cells = np.argwhere(floor)
    places = centres_of(floor, geometry)
    near = np.zeros(len(places), np.bool_)
    for start, end in itertools.chain.from_iterable(strips):
        length_m = max(start.distance_m(end), 1e-9)
        along_x, along_y = (end.x_m - start.x_m) / length_m, (end.y_m - start.y_m) / length_m
        x_m, y_m = (places - (start.x_m, start.y_m)).T
        beyond_m = x_m * along_x + y_m * along_y
        beyond_m -= np.clip(beyond_m, 0.0, length_m)
        aside_m = y_m * along_x - x_m * along_y
        near |= np.hypot(beyond_m, aside_m) <= width_m / 2 + geometry.resolution_m / 2
    covered = np.zeros_like(floor)
    covered[tuple(cells[near].T)] = True
    return covered


def _cells(
    floor: NDArray[np.bool_], geometry: GridGeometry, direction_rad: float, width_m: float, spacing_m: float
) -> list[Strip]:
    """Cells of the decomposition, by their lines in a direction, evenly and at most `spacing_m` apart.

    The lines of a cell are either all shorter than half a working width, or none is.
    """
    centres = centres_of(floor, geometry)
    if not len(centres):
        return []
    along = (math.cos(direction_rad), math.sin(direction_rad))
    across = (-along[1], along[0])
    us_m, vs_m = (centres[:, 0] * axis[0] + centres[:, 1] * axis[1] for axis in (along, across))
    half_m = geometry.resolution_m / 2
    low_m, extent_m = vs_m.min() - half_m, np.ptp(vs_m) + 2 * half_m
    count = max(1, math.ceil(extent_m / spacing_m))
    samples_m = np.arange(us_m.min(), us_m.max() + half_m, half_m)
    cells: list[Strip] = []
    before: list[tuple[float, float, Strip]] = []
    """Runs of the line before: start, end, and the cell."""

    def near(run: tuple[float, float], other: tuple[float, float]) -> bool:
        is_short = [end - start < width_m / 2 for start, end in (run, other)]
        return run[0] < other[1] and other[0] < run[1] and is_short[0] == is_short[1]

    for line in range(count):
        v_m = low_m + (line + 0.5) * extent_m / count
        runs = _runs(floor, geometry, samples_m, v_m, along, across)
        now: list[tuple[float, float, Strip]] = []
        for low, high in runs:
            parents = [parent for parent in before if near(parent[:2], (low, high))]
            children = [run for run in runs if parents and near(parents[0][:2], run)]
            if len(parents) == 1 == len(children):
                cell = parents[0][2]
            else:
                cells.append(cell := [])
            start, end = (
                Point2D(float(u_m * along[0] + v_m * across[0]), float(u_m * along[1] + v_m * across[1]))
                for u_m in (low, high)
            )
            cell.append((start, end))
            now.append((low, high, cell))
        before = now
    return cells


def _middle(lane: Lane) -> Point2D:
    return Point2D((lane[0].x_m + lane[1].x_m) / 2, (lane[0].y_m + lane[1].y_m) / 2)


def _length_m(lane: Lane) -> float:
    return lane[0].distance_m(lane[1])


def _runs(
    floor: NDArray[np.bool_],
    geometry: GridGeometry,
    samples_m: Floats,
    v_m: float,
    along: tuple[float, float],
    across: tuple[float, float],
) -> list[tuple[float, float]]:
    """Starts and ends, metres along, of the parts of a lane that are on the floor."""
    columns, rows = (
        np.floor((samples_m * along[axis] + v_m * across[axis] - origin_m) / geometry.resolution_m).astype(np.int64)
        for axis, origin_m in ((0, geometry.origin_x_m), (1, geometry.origin_y_m))
    )
    is_on = (rows >= 0) & (rows < floor.shape[0]) & (columns >= 0) & (columns < floor.shape[1])
    is_on[is_on] = floor[rows[is_on], columns[is_on]]
    edges = np.flatnonzero(np.diff(np.concatenate(([False], is_on, [False]))))
    return [(float(samples_m[low]), float(samples_m[high - 1])) for low, high in edges.reshape(-1, 2)]
