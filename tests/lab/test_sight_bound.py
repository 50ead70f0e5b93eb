"""How soon robots that know a floor could have seen it."""

import math

import numpy as np
import pytest

from robrain.lab.bench.exploration import STANDPOINT_M, bound_s, sight_bound_s
from robrain.protocol.model.geometry import Point2D
from robrain.sim.maps.floor_plan import FloorPlan

SLACK_M = STANDPOINT_M * math.sqrt(2.0) + 0.1


def corridor(*, door_at_m: float | None = None) -> FloorPlan:
    """20 m × 1 m at 0.1 m; with a door, a room of 6 m × 3 m above it that is open only there."""
    occupied = np.ones((60, 202), np.bool_)
    occupied[1:11, 1:201] = False
    if door_at_m is not None:
        occupied[12:42, 141:201] = False
        column = 1 + round(10 * door_at_m)
        occupied[11, column - 5 : column + 5] = False
    return FloorPlan(occupied, 0.1, 0.0, 0.0, "corridor")


def test_a_straight_corridor_is_seen_from_one_range_before_its_end() -> None:
    plan, start = corridor(), Point2D(1.0, 0.6)
    assert sight_bound_s(plan, start, 0.2, 6.0, 0.5) == pytest.approx(
        bound_s(plan, start, 0.2, 6.0, 0.5), abs=SLACK_M / 0.5
    )


def test_a_room_behind_a_wall_is_not_seen_before_its_door() -> None:
    plan, start = corridor(door_at_m=19.0), Point2D(1.0, 0.6)
    assert bound_s(plan, start, 0.2, 6.0, 0.5) > 0
    assert sight_bound_s(plan, start, 0.2, 6.0, 0.5) > bound_s(plan, start, 0.2, 6.0, 0.5) + 2.0
