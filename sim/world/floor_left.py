"""Regions of the floor that a run left unexplored, and why: as values and in words."""

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robrain.algorithms.navigation.clearance import least_clearance_m
from robrain.protocol.model.geometry import Point2D
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.world.referee import Referee

LEAST_AREA_M2 = 0.5
"""Smaller regions are not reported."""
MAX_REGIONS = 20
GAP_STEPS = 40
"""Steps, from the width that robots need down to 0, in which a gap's width is searched."""


class NotSeen(msgspec.Struct, frozen=True, kw_only=True, tag_field="code", tag="not_seen"):
    """Robots can get there but have not seen it."""


class GapTooNarrow(msgspec.Struct, frozen=True, kw_only=True, tag_field="code", tag="gap_too_narrow"):
    """Even the widest way there has a gap too narrow for the robots; the referee does not count this floor."""

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
        starts: where the robots started, arena frame.
        radius_m: radius of the robots.
        referee: holds what they have seen.

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
    cells = [cell for start in starts if plan.holds_cell(*(cell := plan.cell_of(start.x_m, start.y_m)))]
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
                        place=plan.centre_of(*_middle(region)),
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
