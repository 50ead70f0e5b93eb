"""Teams that know their floor before the run: from its plan, from a map file, or from an earlier run."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robrain.client.team import Team
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.reader.floor_file import read_floor
from robrain.sim.errors import ScenarioError
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.maps.drawing import Block, FloorDrawing
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.robot_specs import RobotSpec

DEPOT = Scenario.builtin("depot").replace(robots=2, motes=0, seed=3)
FAR = (3.0, 3.0)
"""A place in the depot, 18 m from the robots' starts."""
BOX, GONE = Block(x_m=5.0, y_m=1.2, width_m=0.8, height_m=1.6), Block(x_m=8.0, y_m=0.4, width_m=0.6, height_m=0.6)
ROOM = Scenario(name="room", floor=FloorDrawing(size_m=(12.0, 4.0), blocks=(BOX,)), robots=2, near=Point2D(1.5, 2.0))


def run_of(team: Team) -> LockstepRun:
    assert isinstance(team.transport, LockstepTransport)
    return team.transport.run


def share_of(run: LockstepRun, block: Block, kind: np.int8) -> float:
    """Share of the cells of the team's map within a block, and along its sides, that are of a class."""
    grid = run.coordinator.team_map.seen
    assert grid is not None
    top, left = grid.geometry.cell_of(block.x_m + 0.01, block.y_m + 0.01)
    end = grid.geometry.cell_of(block.x_m + block.width_m - 0.01, block.y_m + block.height_m - 0.01)
    return float((grid.classes()[top : end[0] + 1, left : end[1] + 1] == kind).mean())


def map_file(scenario: Scenario, folder: Path) -> Path:
    world = scenario.world()
    (folder / "map.png").write_bytes(world.map_png())
    path = folder / "floor.yaml"
    path.write_text(world.map_yaml())
    return path


@pytest.mark.slow
def test_team_drives_to_a_far_place_at_once_and_explores_nothing() -> None:
    with DEPOT.replace(known_floor=True).team() as team:
        team.run_for(1.5)
        submitted = team.submit("visit", place=FAR)
        team.run_for(2.0)
        begun, begun_s = team.get(submitted), team.now_s
        assert begun.state is TaskState.RUNNING
        assert begun.estimate is not None
        assert team.wait(submitted).state is TaskState.DONE
        assert team.now_s - begun_s == pytest.approx(begun.estimate.ends_in_s, rel=0.2)
        assert len(team.list()) == 1
        run = run_of(team)
        for body, host in zip(run.arena.bodies, run.hosts, strict=True):
            assert math.hypot(body.x_m - host.board.pose.x_m, body.y_m - host.board.pose.y_m) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    "starts",
    [
        {"starts_known": False},
        {"robots": 1, "roster": (RobotSpec(plugins={"localisation": {"x_m": 3.0}}),)},
    ],
    ids=["unknown", "wrong"],
)
def test_robots_with_unknown_or_wrong_starts_find_their_places_on_it(starts: dict[str, Any]) -> None:
    with DEPOT.replace(known_floor=True, **starts).team() as team:
        run = run_of(team)
        team.run_for(2.0)
        assert all(host.board.frame != ARENA for host in run.hosts)
        assert team.run_for(60.0, until=lambda: all(not host.board.lost for host in run.hosts))
        for body, host in zip(run.arena.bodies, run.hosts, strict=True):
            assert math.hypot(body.x_m - host.board.pose.x_m, body.y_m - host.board.pose.y_m) < 0.2


@pytest.mark.slow
def test_new_obstacles_are_found_and_passed_and_removed_ones_disappear(tmp_path: Path) -> None:
    before = ROOM.replace(floor=FloorDrawing(size_m=(12.0, 4.0), blocks=(GONE,)))
    scenario = ROOM.replace(known_floor=map_file(before, tmp_path))
    assert Scenario.from_toml(scenario.to_toml()).known_floor == scenario.known_floor
    with scenario.team() as team:
        run = run_of(team)
        team.run_for(1.0)
        assert share_of(run, BOX, FREE) > 0.8  # the front is in sight
        assert share_of(run, GONE, OCCUPIED) > 0.5
        assert team.wait(team.submit("visit", place=(10.5, 2.0))).state is TaskState.DONE
        assert run.truth.robots[0].collisions + run.truth.robots[1].collisions == 0
        assert share_of(run, BOX, OCCUPIED) > 0.2
        assert share_of(run, GONE, FREE) == 1.0


@pytest.mark.slow
def test_recording_of_an_earlier_run_is_a_known_floor(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    with ROOM.team(record=recording) as team:
        team.run_for(40.0)
        first = run_of(team).coordinator.team_map.seen
        assert first is not None
    floor = read_floor(recording)
    assert np.array_equal(floor.classes, first.classes())
    assert len(floor.walls) > 100
    clearance_m = ROOM.plan().clearance_m
    geometry = ROOM.plan().geometry
    cells = [geometry.cell_of(x_m, y_m) for x_m, y_m, _, _ in floor.walls if 0.1 < x_m < 11.9 and 0.1 < y_m < 3.9]
    assert np.mean([clearance_m[cell] < 0.06 for cell in cells]) > 0.95
    with ROOM.replace(known_floor=recording).team() as team:
        team.run_for(1.0)
        assert run_of(team).coordinator.team_map.known_area_m2 > 0.9 * first.known_count * 0.01


@pytest.mark.parametrize(("name", "reason"), [("none.yaml", "found none"), ("none.mcap", "none.mcap")])
def test_file_without_a_map_is_refused(tmp_path: Path, name: str, reason: str) -> None:
    with pytest.raises(ScenarioError, match=reason):
        ROOM.replace(known_floor=tmp_path / name).world()
