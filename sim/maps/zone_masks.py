"""Zones from masks of Nav2's costmap filters, which are maps in the ROS map_server format.

A keep-out mask forbids cells of 100 per cent; robots pass all others. A cell of a speed mask
with v per cent has the limit base + multiplier · v. Unknown cells and those of 0 per cent have none. Both are as in
Nav2's filters.
"""

import math
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.zone import Corner, Zone, ZoneKind
from robrain.recording.reader.map_server import MapSettings, read_occupancy

CELL_M = 0.1
"""Cells of a mask are merged to squares of at least this size, as the cells of the team's map: thin lines hold too."""
Vertex = tuple[int, int]
"""Column and row."""


class SpeedScale(NamedTuple):
    """Speed limits of a mask, as of Nav2's `CostmapFilterInfo`."""

    base: float
    multiplier: float
    fastest_m_s: float | None = None
    """Speed of which the limits are per cent (type 1); None if they are m/s (type 2)."""

    def limit_m_s(self, percent: int) -> float:
        """Limit of a cell; not above 0 if it has none."""
        limit = self.base + self.multiplier * percent
        if self.fastest_m_s is None:
            return limit
        return 0.0 if limit > 100.0 else 0.01 * limit * self.fastest_m_s


def zones_of_mask(path: Path, name: str, scale: SpeedScale | None = None) -> list[Zone]:
    """The zones of a mask: one keep-out zone, or with a scale one zone for each speed limit.

    Args:
        path: YAML file of the mask.
        name: of the zone; zones with speed limits have it with `-` and their per cent.
        scale: of a speed mask.

    Raises:
        MapError: the files cannot be read.
        ValueError: a zone would have too many corners.

    """
    cells, settings = read_occupancy(path)
    if scale is None:
        corners_m = _outline(cells == 100, settings)
        return [Zone(name=name, kind=ZoneKind.KEEP_OUT, corners_m=corners_m)] if corners_m else []
    limits_m_s = {percent: scale.limit_m_s(percent) for percent in np.unique(cells[cells > 0]).tolist()}
    return [
        Zone(
            name=f"{name}-{percent}",
            kind=ZoneKind.SPEED_LIMIT,
            corners_m=_outline(cells == percent, settings),
            speed_m_s=limit_m_s,
        )
        for percent, limit_m_s in limits_m_s.items()
        if limit_m_s > 0.0
    ]


def _outline(mask: NDArray[np.bool_], settings: MapSettings) -> tuple[Corner, ...]:
    """Corners of a zone of the cells in a mask (H, W); sides that are passed twice join its parts and holes."""
    step = math.ceil(CELL_M / settings.resolution - 1e-6)
    padded = np.pad(mask, [(0, -size % step) for size in mask.shape])
    rows, columns = padded.shape[0] // step, padded.shape[1] // step
    rings = _rings(padded.reshape(rows, step, columns, step).max(axis=(1, 3)))
    chain = [vertex for ring in rings for vertex in (*ring, ring[0])] + [ring[0] for ring in rings[-2::-1]]
    pitch_m, (x_m, y_m, _) = step * settings.resolution, settings.origin
    return tuple((round(x_m + column * pitch_m, 6), round(y_m + row * pitch_m, 6)) for column, row in chain)


def _rings(mask: NDArray[np.bool_]) -> list[list[Vertex]]:
    """Corners of the borders of the cells in a mask (H, W): outer ones counter-clockwise, holes clockwise."""
    around = np.pad(mask, 1)
    ends: defaultdict[Vertex, list[Vertex]] = defaultdict(list)
    sides = (
        (around[:-2, 1:-1], (0, 0), (1, 0)),
        (around[1:-1, 2:], (1, 0), (1, 1)),
        (around[2:, 1:-1], (1, 1), (0, 1)),
        (around[1:-1, :-2], (0, 1), (0, 0)),
    )
    for outside, (x0, y0), (x1, y1) in sides:
        for row, column in np.argwhere(mask & ~outside).tolist():
            ends[column + x0, row + y0].append((column + x1, row + y1))
    rings = []
    while ends:
        ring = [next(iter(ends))]
        while len(ring) == 1 or ring[-1] != ring[0]:
            vertex = ring[-1]
            ring.append(ends[vertex].pop())
            if not ends[vertex]:
                del ends[vertex]
        corners = zip((ring[-2], *ring), ring[:-1], ring[1:], strict=False)
        rings.append([at for before, at, after in corners if before[0] != after[0] and before[1] != after[1]])
    return rings
