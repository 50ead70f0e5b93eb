"""What the page shows of a lockstep run that has not begun."""

import zlib

import numpy as np

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.dashboard.html.team_html import strip_html
from robrain.dashboard.state.alerts import alerts_of
from robrain.dashboard.state.headline import Grade, headline_of, vitals_of
from robrain.dashboard.state.shown_robot import RobotHealth
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, MapPatch
from robrain.protocol.messages.team import arena_messages
from robrain.protocol.messages.team.arena_messages import (
    ArenaClock,
    ArenaPreparation,
    ArenaTruth,
    MoteTruth,
    RobotTruth,
)
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from tests.dashboard.test_shown_team import tell, token

CELLS = np.array([[0, 100, -1], [0, 0, 100]], np.int8)
LONG_S = 60.0


def preparation(columns: int = 3) -> ArenaPreparation:
    floor = MapPatch(
        robot="arena",
        resolution_m=0.5,
        origin_x_m=0.0,
        origin_y_m=0.0,
        width=columns,
        height=2,
        rows=2,
        columns=3,
        cells=zlib.compress(CELLS.tobytes()),
    )
    robot = RobotTruth(robot="r1", pose=Pose2D(1.0, 0.5, 0.0), collisions=0, distance_m=0.0, energy_j=0.0)
    truth = ArenaTruth(sim_time_s=0.0, robots=[robot], motes=[MoteTruth(mote="m1", place=Point2D(0.5, 0.5))])
    return ArenaPreparation(parts_ready=3, parts=16, remaining_s=12.2, floor=floor, truth=truth)


def prepared() -> ShownTeam:
    view = ShownTeam()
    view.coordinator_up = True
    view.apply_presence(token("r1", True))
    tell(view, arena_messages.ARENA_PREPARATION, preparation())
    return view


def test_plan_is_drawn_until_the_first_tick_and_then_the_map_replaces_it() -> None:
    view = prepared()
    assert view.floor is not None
    assert np.array_equal(view.floor.classes, CELLS)
    assert view.robots["r1"].pose == Pose2D(1.0, 0.5, 0.0)
    assert view.motes["m1"].place == Point2D(0.5, 0.5)
    # Waiting robots are ready, and nothing is wrong however long it takes.
    assert view.robots["r1"].condition(LONG_S) is RobotHealth.READY
    assert headline_of(vitals_of(view, LONG_S)).grade is Grade.GOOD
    assert alerts_of(view, LONG_S) == []
    version = view.floor_version
    tell(view, arena_messages.ARENA_CLOCK, ArenaClock(sim_time_s=0.1))
    assert view.preparation is None
    assert view.robots["r1"].pose is None
    assert "preparation" not in strip_html(view, 0.0)
    assert np.array_equal(view.floor.classes, CELLS)
    patch = to_message("r1", GridGeometry(0.5, 0.0, 0.0, 4, 4), PatchCells(0, 0, CELLS, 1))
    tell(view, ROBOT_MAP, patch, robot="r1")
    assert view.floor.geometry.shape == (4, 4)
    assert view.floor_version != version


def test_plan_that_does_not_fill_its_grid_is_rejected_whole() -> None:
    view = ShownTeam()
    tell(view, arena_messages.ARENA_PREPARATION, preparation(columns=4))
    assert view.rejected == 1
    assert view.preparation is None
    assert view.floor is None
    assert not view.robots
