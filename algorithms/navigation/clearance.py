"""How much room a round robot needs: the one definition of which floor can be driven.

Robots keep `PREFERRED_MARGIN_M` from obstacles where a path has that much room. Where none has, they squeeze, slowly,
through gaps that leave `LEAST_MARGIN_M` on each side; the referee counts floor behind such gaps as reachable. The map
for planning is too coarse to distinguish such a gap from a slightly narrower one. A plan uses a gap that may be wide
enough. The robot then decides by its sensors in front of the gap.
"""

import math

PREFERRED_MARGIN_M = 0.08
"""Margin beyond the radius, where there is room."""
LEAST_MARGIN_M = 0.02
"""Margin beyond the radius in the narrowest gap (chosen: two standard deviations of a lidar's range)."""


def least_clearance_m(radius_m: float) -> float:
    """The least clearance that a robot of this radius needs."""
    return radius_m + LEAST_MARGIN_M


def least_gap_m(radius_m: float) -> float:
    """The width of the narrowest gap that a robot of this radius drives through."""
    return 2.0 * least_clearance_m(radius_m)


def mapped_gap_cells(radius_m: float, resolution_m: float) -> int:
    """The least number of whole free cells that the narrowest gap that can be driven shows on a map, at least 1.

    A gap of width w between walls along the axes leaves floor(w / a) − 1 to w / a cells of size a free. So a gap that
    shows n cells has a width of n to n + 2 cells. The map cannot show whether it is one cell too narrow.
    """
    return max(1, math.floor(least_gap_m(radius_m) / resolution_m + 1e-9) - 1)


def mapped_clearance_m(radius_m: float, resolution_m: float) -> float:
    """The clearance on a map, between cell centres, below which no gap can be driven.

    A gap of width w leaves at least floor(w / a) − 1 whole cells of size a between the cells of its walls. The middle
    cell is more than w/2 − a from either wall. The gap must be at least two cells wide.
    """
    return max(resolution_m, least_clearance_m(radius_m) - resolution_m)
