"""How much room a round robot takes: the one definition of which floor can be driven.

Robots keep `PREFERRED_MARGIN_M` from what stands around wherever a way has so much room. Where none has, they squeeze
through whatever leaves `LEAST_MARGIN_M` on each side, slowly. That is what the referee counts as floor that robots can
reach. The map that robots plan on is too coarse to tell such a gap from one that is a little less: plans hold a gap
for one that can be driven where it may be one, and what the robot sees before it decides.
"""

PREFERRED_MARGIN_M = 0.08
"""Kept from obstacles, beyond the radius, where there is room."""
LEAST_MARGIN_M = 0.02
"""Kept in the narrowest place that is driven through (chosen: two standard deviations of a lidar's range)."""


def least_clearance_m(radius_m: float) -> float:
    """The clearance that a robot of this radius cannot do without."""
    return radius_m + LEAST_MARGIN_M


def least_gap_m(radius_m: float) -> float:
    """The width of the narrowest gap that a robot of this radius drives through."""
    return 2.0 * least_clearance_m(radius_m)


def mapped_clearance_m(radius_m: float, resolution_m: float) -> float:
    """The clearance on a map's cells below which no gap can be driven, from middle to middle of cells.

    A gap of width w leaves at least floor(w / a) − 1 whole cells of size a between the cells that its walls lie in;
    the middle one is more than w/2 − a from either. Cells must be at most half as wide as the gap.
    """
    return max(resolution_m, least_clearance_m(radius_m) - resolution_m)
