"""Which zones separate a place from all robots."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robrain.algorithms.mapping.zone_grid import cells_in
from robrain.algorithms.navigation.navigation_grid import clearance_m
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import OCCUPIED, GridGeometry
from robrain.protocol.model.zone import Zone, ZoneKind


def separating_zones(
    classes: NDArray[np.int8],
    geometry: GridGeometry,
    zones: Sequence[Zone],
    place: Point2D,
    robots: Sequence[Point2D],
    radius_m: float,
    near_m: float,
) -> list[str]:
    """Names of the zones without which a robot could come within `near_m` of a place; none if one can now.

    Keep-out zones count, and shut doors. Unknown floor counts as free. A robot that stands in a keep-out zone leaves it
    first, so nothing is known of it.

    Args:
        classes: (H, W) of the map without zones.
        geometry: of the grid.
        zones: all zones.
        place: the place, arena frame.
        robots: places of the robots.
        radius_m: of the smallest robot.
        near_m: how far from the place a robot may stay.

    """
    is_open = np.logical_or.reduce(
        [classes != OCCUPIED, *(cells_in(z, geometry) for z in zones if z.kind is ZoneKind.DOOR)]
    )
    masks = {zone.name: cells_in(zone, geometry) for zone in zones if zone.kind is ZoneKind.KEEP_OUT or zone.is_shut}
    at = [geometry.cell_of(robot.x_m, robot.y_m) for robot in robots]
    cells = [cell for cell in at if geometry.contains(*cell)]
    if not cells or any(mask[cell] for mask in masks.values() for cell in cells):
        return []
    row, column = geometry.cell_of(place.x_m, place.y_m)
    rows, columns = np.ogrid[: geometry.height, : geometry.width]
    around = (rows - row) ** 2 + (columns - column) ** 2 <= (near_m / geometry.resolution_m) ** 2

    def is_reached(closed: Sequence[NDArray[np.bool_]]) -> bool:
        occupied = np.logical_or.reduce([~is_open, *closed])
        near_wall_m = clearance_m(occupied, geometry.resolution_m, radius_m + geometry.resolution_m)
        labels, _ = ndimage.label(near_wall_m >= radius_m, np.ones((3, 3)))
        here = {int(labels[cell]) for cell in cells} - {0}
        return not here or not here.isdisjoint(np.unique(labels[around]).tolist())

    if not masks or is_reached([*masks.values()]) or not is_reached([]):
        return []
    alone = [name for name in masks if is_reached([mask for other, mask in masks.items() if other != name])]
    return alone or [*masks]
