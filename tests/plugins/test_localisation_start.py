"""What the others had mapped before a robot came tells it whether it is where it was told; later, how well it fits."""

import math

import numpy as np
import pytest

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.submap import IDENTITY
from robrain.protocol.model.occupancy_grid import FREE, OCCUPIED, GridGeometry, OccupancyGrid
from robrain.protocol.wire.topics import ROBOT_EVENT

GEOMETRY = GridGeometry(0.1, -8.0, -8.0, 160, 160)
GRID = {"resolution_m": 0.1, "origin_x_m": -8.0, "origin_y_m": -8.0, "width_m": 16.0, "height_m": 16.0}
SQUARE_M = [min(2.0 / max(abs(math.cos(a)), abs(math.sin(a))), 5.0) for a in np.linspace(-np.pi, np.pi, 361)[:-1]]
NARROW_M = [0.5 * range_m for range_m in SQUARE_M]


def room_of_others(half_m=2.0):
    """A square room about the origin that the others know, in one statement."""
    cells = np.full((60, 60), FREE, np.int8)
    wall = round(half_m / 0.1)
    inner = np.s_[30 - wall : 30 + wall, 30 - wall : 30 + wall]
    around = np.full((60, 60), OCCUPIED, np.int8)
    around[inner] = cells[inner]
    grid = OccupancyGrid(GEOMETRY)
    grid.merge_patch(50, 50, around, 5)
    return grid


def started(stage, **parameters):
    one = stage()
    host = one.host("localisation", localisation=parameters)
    return one, host


def standing(one, seconds, ranges_m=SQUARE_M):
    one.run(seconds, lambda: one.stand_and_scan(ranges_m))


@pytest.mark.parametrize(("half_m", "is_lost"), [(2.0, False), (1.0, True)])
def test_a_robot_that_does_not_see_what_the_others_have_mapped_there_started_elsewhere(stage, half_m, is_lost):
    one, host = started(stage)
    events = one.inbox(ROBOT_EVENT, robot="r1", plugin="localisation", event="diverged")
    host.board.map_of_others = room_of_others(half_m)
    standing(one, 0.3)
    assert bool(host.board.lost) == host.board.false_start == is_lost
    assert [received.message.value["is_lost"] for received in events.drain()] == [True] * is_lost


def test_without_a_map_of_others_every_start_is_believed(stage):
    one, host = started(stage)
    standing(one, 0.3)
    assert host.board.lost == ""
    host.board.map_of_others = OccupancyGrid(GEOMETRY)
    standing(one, 0.3)
    assert (host.board.lost, host.board.false_start) == ("", False)


def test_each_state_of_the_others_map_is_looked_at_once(stage):
    """What comes to stand in the way afterwards does not make the start a false one."""
    one, host = started(stage)
    others = host.board.map_of_others = room_of_others()
    standing(one, 0.3)
    standing(one, 0.3, NARROW_M)
    assert host.board.lost == ""
    others.merge_patch(0, 0, np.full((1, 1), FREE, np.int8), 6)
    standing(one, 0.3, NARROW_M)
    assert host.board.false_start
    assert "on the map of the others" in host.board.lost


def test_a_robot_that_was_told_that_it_starts_elsewhere_is_held_against_the_map_there(stage):
    one, host = started(stage, x_m=1.0, y_m=-0.5, yaw_rad=0.3)
    host.board.map_of_others = room_of_others()
    standing(one, 0.3)
    assert host.board.false_start, "what it sees is seen from the middle"


@pytest.mark.parametrize(("beams", "is_told"), [(0, False), (1, True), (90, True)])
def test_whoever_sees_a_wall_tells_how_well_it_fits_the_teams_map(stage, beams, is_told):
    one = stage()
    host = one.host("localisation", "mapper", mapper=GRID)
    standing(one, 1.0)
    host.board.map_agreement = None
    standing(one, 2.0, [2.0] * beams or [0.0] * 90)
    assert (host.board.map_agreement is not None) == is_told


def test_where_the_teams_map_knows_less_than_half_of_what_is_seen_nothing_is_told(stage):
    one = stage()
    host = one.host("localisation", "mapper", mapper=GRID)
    standing(one, 1.0)
    host.board.map_agreement = None
    host.manager.get("localisation").plugin._localiser.shift(Pose2D(5.0, 0.0, 0.0))
    standing(one, 1.2)
    assert host.board.map_agreement is None
    assert host.board.T_arena_odom != IDENTITY
