"""Coverage of an area: by lanes that a robot drives, or by the view from one place.

Lanes follow the boustrophedon decomposition (H. Choset, Coverage of Known Spaces: The Boustrophedon Cellular
Decomposition, Autonomous Robots 9, 2000). Obstacles cut parallel lanes into runs. A strip ends where a run splits or
runs join, so a robot can drive each strip to and fro without a detour.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.mapping.zone_grid import cells_in
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

    They run along its longest side or across it, whichever needs fewer lanes.
    """
    ends = [*area[1:], area[0]]
    start, end = max(zip(area, ends, strict=True), key=lambda side: side[0].distance_m(side[1]))
    yaw_rad = math.atan2(end.y_m - start.y_m, end.x_m - start.x_m)
    found = [_strips(floor, geometry, yaw_rad + turn_rad, width_m) for turn_rad in (0.0, math.pi / 2)]
    return min(found, key=lambda strips: sum(map(len, strips)))


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


def _strips(floor: NDArray[np.bool_], geometry: GridGeometry, yaw_rad: float, width_m: float) -> list[Strip]:
    """The strips of lanes in a direction."""
    centres = centres_of(floor, geometry)
    if not len(centres):
        return []
    along, across = (math.cos(yaw_rad), math.sin(yaw_rad)), (-math.sin(yaw_rad), math.cos(yaw_rad))
    us_m, vs_m = (centres[:, 0] * axis[0] + centres[:, 1] * axis[1] for axis in (along, across))
    half_m = geometry.resolution_m / 2
    low_m, extent_m = vs_m.min() - half_m, np.ptp(vs_m) + 2 * half_m
    count = max(1, math.ceil(extent_m / width_m))
    samples_m = np.arange(us_m.min(), us_m.max() + half_m, half_m)
    strips: list[Strip] = []
    before: list[tuple[float, float, int]] = []
    """Runs of the lane before: start, end, and the number of the strip."""
    for lane in range(count):
        v_m = low_m + (lane + 0.5) * extent_m / count
        runs = _runs(floor, geometry, samples_m, v_m, along, across)
        kept = [run for run in runs if run[1] - run[0] >= width_m / 2] or runs
        now: list[tuple[float, float, int]] = []
        for low, high in kept:
            parents = [run for run in before if run[0] < high and low < run[1]]
            children = [run for run in kept if parents and run[0] < parents[0][1] and parents[0][0] < run[1]]
            if len(parents) != 1 or len(children) != 1:
                strips.append([])
            strip = parents[0][2] if len(parents) == 1 == len(children) else len(strips) - 1
            start, end = (
                Point2D(float(u_m * along[0] + v_m * across[0]), float(u_m * along[1] + v_m * across[1]))
                for u_m in (low, high)
            )
            strips[strip].append((start, end))
            now.append((low, high, strip))
        before = now
    return strips


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
