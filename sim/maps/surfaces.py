"""Walls of glass and mirrors, drawn from the seed: `[surfaces]` of a scenario.

For bodies, range sensors and cameras they are ordinary walls. Lidars see through glass, and reflections in mirrors.
"""

from typing import Annotated, NamedTuple, Self

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from robrain.algorithms.mapping.ray_cast import (
    GLASS_X,
    GLASS_Y,
    MIRROR_EAST,
    MIRROR_NORTH,
    MIRROR_SOUTH,
    MIRROR_WEST,
    SOLID,
    cast_rays,
)
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.ranges import Share
from robrain.sim.maps.floor_plan import FloorPlan

PANE_M = 0.45
"""Largest thickness of glass, metres."""
STRAIGHT_M = 0.5
"""Least length of a straight wall that may be glass or a mirror, metres."""
_RNG_OF_SURFACES = 2


class SurfaceSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[surfaces]`: walls of glass and mirrors; the default is none.

    Shares are by length, of straight walls along the axes. Raises ValueError for impossible values.
    """

    glass_share: Share = 0.0
    """Share of the thin walls (at most 0.45 m) that is glass."""
    mirror_share: Share = 0.0
    """Share of the sides of walls that are mirrors."""
    stretch_m: Annotated[float, Meta(ge=STRAIGHT_M, le=1000)] = 3.0
    """Length of a stretch of glass or mirror, metres."""
    echo_rad: Annotated[float, Meta(ge=0, le=1.5)] = 0.2
    """Largest angle between a beam and a pane's normal at which the pane returns the beam."""

    @property
    def is_plain(self) -> bool:
        """Whether there is neither glass nor a mirror."""
        return self.glass_share == 0 and self.mirror_share == 0


class _Stretch(NamedTuple):
    """A box of wall cells, last row and column exclusive, and the surface that they get."""

    row: int
    column: int
    last_row: int
    last_column: int
    surface: int

    @property
    def cells(self) -> int:
        """Its length in cells."""
        if self.surface in _ALONG_X:
            return self.last_column - self.column
        return self.last_row - self.row


_ALONG_X = (GLASS_Y, MIRROR_SOUTH, MIRROR_NORTH)
"""Surfaces whose walls run along x."""


class FloorSurfaces:
    """Surfaces of a floor, as lidars see them.

    Args:
        cells: (H, W), surfaces as in `robrain.algorithms.mapping.ray_cast`.
        geometry: grid of the cells, arena frame.
        echo_rad: largest angle between a beam and a pane's normal at which the pane returns the beam.

    """

    def __init__(self, cells: NDArray[np.uint8], geometry: GridGeometry, echo_rad: float) -> None:
        self.cells = cells
        self._geometry = geometry
        self._echo_rad = echo_rad

    @classmethod
    def draw(cls, spec: SurfaceSpec, plan: FloorPlan, seed: int) -> Self:
        """Draw the surfaces of a floor; the same seed gives the same ones."""
        rng = np.random.default_rng([seed, _RNG_OF_SURFACES])
        cells = np.where(plan.occupied, SOLID, 0).astype(np.uint8)
        length = max(1, round(spec.stretch_m / plan.resolution_m))
        shortest = max(1, round(STRAIGHT_M / plan.resolution_m))
        thickest = round(PANE_M / plan.resolution_m)
        panes = _panes(plan.occupied, thickest, shortest, length)
        for stretch in _chosen(panes, spec.glass_share, rng):
            cells[stretch.row : stretch.last_row, stretch.column : stretch.last_column] |= stretch.surface
        sides = _sides(plan.occupied, shortest, length)
        for stretch in _chosen(sides, spec.mirror_share, rng):
            cells[stretch.row : stretch.last_row, stretch.column : stretch.last_column] |= stretch.surface
        surfaces = cls(cells, plan.geometry, spec.echo_rad)
        surfaces.cast(Pose2D(0.0, 0.0, 0.0), np.zeros(1), 1.0, np.zeros((1, 3)))  # compiled before the first tick
        return surfaces

    def cast(
        self, sensor: Pose2D, angles_rad: NDArray[np.float64], range_max_m: float, circles: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Ranges (N,) of a lidar's beams in metres; see `cast_rays`."""
        return cast_rays(self.cells, self._geometry, sensor, angles_rad, range_max_m, circles, self._echo_rad)


def _panes(occupied: NDArray[np.bool_], thickest: int, shortest: int, length: int) -> list[_Stretch]:
    """Stretches of walls at most `thickest` cells thick that have free floor or the grid's edge on both sides."""
    found = []
    for low, high, first, last in _thin_runs(occupied, thickest, shortest, length):
        found.append(_Stretch(low, first, high, last, GLASS_Y))
    for low, high, first, last in _thin_runs(occupied.T, thickest, shortest, length):
        found.append(_Stretch(first, low, last, high, GLASS_X))
    return found


def _thin_runs(
    occupied: NDArray[np.bool_], thickest: int, shortest: int, length: int
) -> list[tuple[int, int, int, int]]:
    """Stretches of thin walls along x: first row, past-the-end row, first column, past-the-end column."""
    rows = occupied.shape[0]
    framed = np.zeros((rows + 2, occupied.shape[1]), dtype=np.int8)
    framed[1:-1] = occupied
    change = np.diff(framed, axis=0).T
    start_columns, starts = np.nonzero(change == 1)
    _, ends = np.nonzero(change == -1)  # in the same order: each run of a column has one start and one end
    is_thin = (ends - starts <= thickest) & ~((starts == 0) & (ends == rows))
    columns, starts, ends = start_columns[is_thin], starts[is_thin], ends[is_thin]
    order = np.lexsort((columns, ends, starts))
    columns, starts, ends = columns[order], starts[order], ends[order]
    goes_on = (np.diff(columns) == 1) & (np.diff(starts) == 0) & (np.diff(ends) == 0)
    found = []
    for run in np.split(np.arange(len(columns)), np.flatnonzero(~goes_on) + 1):
        if len(run) >= shortest:
            low, high, first = int(starts[run[0]]), int(ends[run[0]]), int(columns[run[0]])
            for begin, end in _pieces(len(run), length):
                found.append((low, high, first + begin, first + end))
    return found


def _sides(occupied: NDArray[np.bool_], shortest: int, length: int) -> list[_Stretch]:
    """Stretches of straight sides of walls that face free floor."""
    found = []
    framed = np.pad(occupied, 1, constant_values=True)
    south, north = framed[:-2, 1:-1], framed[2:, 1:-1]
    west, east = framed[1:-1, :-2], framed[1:-1, 2:]
    for beside, surface in ((south, MIRROR_SOUTH), (north, MIRROR_NORTH)):
        for row, first, last in _runs(occupied & ~beside, shortest, length):
            found.append(_Stretch(row, first, row + 1, last, surface))
    for beside, surface in ((west, MIRROR_WEST), (east, MIRROR_EAST)):
        for column, first, last in _runs((occupied & ~beside).T, shortest, length):
            found.append(_Stretch(first, column, last, column + 1, surface))
    return found


def _runs(marked: NDArray[np.bool_], shortest: int, length: int) -> list[tuple[int, int, int]]:
    """Pieces of runs of marked cells within rows: row, first column, past-the-end column."""
    framed = np.zeros((marked.shape[0], marked.shape[1] + 2), dtype=np.int8)
    framed[:, 1:-1] = marked
    change = np.diff(framed, axis=1)
    rows, starts = np.nonzero(change == 1)
    _, ends = np.nonzero(change == -1)
    found: list[tuple[int, int, int]] = []
    for row, start, end in zip(rows.tolist(), starts.tolist(), ends.tolist(), strict=True):
        if end - start >= shortest:
            found.extend((row, start + begin, start + stop) for begin, stop in _pieces(end - start, length))
    return found


def _pieces(cells: int, length: int) -> list[tuple[int, int]]:
    """First and past-the-end cell of each piece of a run; the last piece is up to half as long again as the others."""
    count = max(1, (cells + length // 2) // length)
    return [(piece * length, (piece + 1) * length if piece + 1 < count else cells) for piece in range(count)]


def _chosen(stretches: list[_Stretch], share: float, rng: np.random.Generator) -> list[_Stretch]:
    """Randomly drawn stretches whose total length is about this share of the length of all."""
    wanted = share * sum(stretch.cells for stretch in stretches)
    chosen, covered = [], 0.0
    for index in rng.permutation(len(stretches)).tolist() if share > 0 else ():
        stretch = stretches[index]
        if covered + stretch.cells / 2 <= wanted:
            chosen.append(stretch)
            covered += stretch.cells
    return chosen
