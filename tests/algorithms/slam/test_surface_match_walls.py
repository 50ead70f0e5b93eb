"""Thin walls with rooms on both sides: each side is a surface of its own, whichever way the wall runs."""

import pytest

from robrain.algorithms.localization.surface_match import match_surface
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.loop_closure import moved
from robrain.protocol.model.geometry import Pose2D
from tests.algorithms.mapping.lidar_floor import ANGLES_RAD, GEOMETRY, NOBODY, RANGE_M, LidarFloor

UPRIGHT = LidarFloor((5.92, 3.4, 6.06, 4.6), (0, 0, 12, 0.2), (0, 7.8, 12, 8))
LEVEL = LidarFloor((5.4, 3.92, 6.6, 4.06), (0, 0, 0.2, 8), (11.8, 0, 12, 8))
BOTH_SIDES = {
    "upright": (UPRIGHT, (1.0, 0.0), [Pose2D(3.9, 4.0, 0.0), Pose2D(8.1, 4.0, 0.0)]),
    "level": (LEVEL, (0.0, 1.0), [Pose2D(6.0, 1.9, 0.0), Pose2D(6.0, 6.1, 0.0)]),
}
"""Floor, direction across the wall, and a place on either side of it."""
CASES = [
    ("upright", Pose2D(4.2, 4.1, 0.3)),
    ("upright", Pose2D(7.9, 3.9, -2.3)),
    ("level", Pose2D(6.1, 2.2, 1.3)),
    ("level", Pose2D(5.9, 5.9, -0.3)),
]


def mapped(floor: LidarFloor, places: list[Pose2D]) -> OccupancyGrid:
    """What a robot has mapped that was on both sides of the wall, one after the other, several times."""
    grid = OccupancyGrid(GEOMETRY, surfaces=True)
    for stamp_ms, place in enumerate(places * 2, 1):
        grid.integrate_scan(place, ANGLES_RAD, floor.ranges_m(place), RANGE_M, stamp_ms, NOBODY)
    return grid


MAPS = {name: mapped(floor, places) for name, (floor, _, places) in BOTH_SIDES.items()}


@pytest.mark.parametrize(("name", "true"), CASES)
@pytest.mark.parametrize("across_m", [-0.1, -0.06, 0.03, 0.06, 0.1])
def test_a_scan_lies_on_the_side_of_a_thin_wall_that_it_has_seen(name: str, true: Pose2D, across_m: float) -> None:
    floor, (by_x, by_y), _ = BOTH_SIDES[name]
    guess = Pose2D(true.x_m + across_m * by_x, true.y_m + across_m * by_y, true.yaw_rad)
    fit, _ = match_surface(MAPS[name], guess, floor.points(true))
    found = moved(guess, fit)
    assert len(fit.directions) >= 2
    assert by_x * (found.x_m - true.x_m) + by_y * (found.y_m - true.y_m) == pytest.approx(0.0, abs=0.01)
