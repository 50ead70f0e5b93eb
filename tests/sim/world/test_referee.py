import zlib

import msgspec
import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, MapPatch
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.world.referee import EDGE_CELLS, Referee, team_geometry

# Two rooms of 2 × 2 m, of which robots reach the left one; cells of 5 cm.
OCCUPIED = np.ones((44, 86), np.bool_)
OCCUPIED[2:42, 2:42] = False
OCCUPIED[2:42, 44:84] = False
PLAN = FloorPlan(OCCUPIED, 0.05, -1.0, -2.0, "two rooms")
GEOMETRY = team_geometry(PLAN)


def patch(row: int, column: int, cells: np.ndarray, /, robot: str = "r1", **changes: object) -> MapPatch:
    """A statement about these cells; row and column count from the corner of the plan."""
    told = to_message(robot, GEOMETRY, PatchCells(row + EDGE_CELLS, column + EDGE_CELLS, cells.astype(np.int8), 5000))
    return msgspec.structs.replace(told, **changes)


@pytest.fixture
def endpoint(wire: Endpoint) -> Endpoint:
    wire.clock.advance_to(5_000_000_000)
    return wire


@pytest.fixture
def referee(endpoint) -> Referee:
    return Referee(PLAN, [Point2D(0.0, -1.0)], 0.2, GEOMETRY, endpoint)


def tell(endpoint: Endpoint, *patches: MapPatch) -> None:
    publishers = {}
    for one in patches:
        if one.robot not in publishers:
            publishers[one.robot] = endpoint.publisher(ROBOT_MAP, robot=one.robot)
        publishers[one.robot].put(one)


def test_only_the_floor_that_robots_reach_counts(endpoint, referee):
    assert referee.explored_fraction == 0.0
    tell(endpoint, patch(0, 22, np.zeros((22, 21))))  # all of the room that nobody reaches
    referee.step()
    assert referee.explored_fraction == 0.0
    tell(endpoint, patch(0, 0, np.zeros((22, 22))))
    referee.step()
    assert referee.explored_fraction == 1.0


def test_the_share_is_that_of_the_area_of_both_robots_patches(endpoint, referee):
    lower, upper = patch(1, 1, np.zeros((5, 20))), patch(6, 1, np.zeros((5, 20)), robot="r2")
    tell(endpoint, lower, upper)
    referee.step()
    reachable = PLAN.reachable([Point2D(0.0, -1.0)], 0.2)
    assert referee.explored_fraction == pytest.approx(reachable[:22].sum() / reachable.sum())
    assert 0.45 < referee.explored_fraction < 0.55


def test_walls_that_are_known_do_not_count_and_no_statement_says_nothing(endpoint, referee):
    cells = np.full((22, 22), -1)
    cells[0, :] = cells[:, 0] = 100
    tell(endpoint, patch(0, 0, cells))
    referee.step()
    assert referee.explored_fraction == 0.0


def test_a_team_cell_weighs_by_the_reachable_floor_in_it(endpoint):
    coarse = team_geometry(PLAN, 0.25)
    referee = Referee(PLAN, [Point2D(0.0, -1.0)], 0.2, coarse, endpoint)
    grid = {name: getattr(coarse, name) for name in ("resolution_m", "origin_x_m", "origin_y_m", "width", "height")}
    tell(endpoint, patch(0, 0, np.zeros((1, coarse.width - 2 * EDGE_CELLS)), **grid))
    referee.step()
    reachable = PLAN.reachable([Point2D(0.0, -1.0)], 0.2)
    assert referee.explored_fraction == pytest.approx(reachable[:5].sum() / reachable.sum())


@pytest.mark.parametrize(
    "changes",
    [
        {"resolution_m": 0.05},  # another grid
        {"cells": b"no deflated bytes"},
        {"cells": zlib.compress(bytes(101))},  # too many
        {"row": 3000},  # far outside the grid
        {"observed_ms": -1},
    ],
)
def test_a_patch_that_cannot_be_is_not_counted_as_explored(endpoint, referee, changes):
    tell(endpoint, patch(0, 0, np.zeros((10, 10)), **changes))
    referee.step()
    assert referee.explored_fraction == 0.0


def test_nothing_reachable_means_nothing_explored(endpoint):
    referee = Referee(PLAN, [], 0.2, GEOMETRY, endpoint)
    tell(endpoint, patch(0, 0, np.zeros((22, 43))))
    referee.step()
    assert referee.explored_fraction == 0.0
