"""What a report gathers of a run: states, truth, map, readings and tasks, message by message."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid, PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.plan_messages import TaskEstimates
from robrain.protocol.messages.tasks.task_messages import TaskEstimate
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import FREE, GridGeometry
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.recording.reader.run_data import RunData, read_run
from tests.recording.stage import write_mcap

START_S = 1000.0
Said = Sequence[tuple[str, float, msgspec.Struct | bytes]]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def gathered(path: Path, said: Said) -> RunData:
    """A run with these messages: key, seconds since its beginning, message."""
    write_mcap(path, [(key, START_S + t_s, message) for key, t_s, message in said])
    return read_run(path)


def key(rest: str) -> str:
    return f"robrain/default/{rest}"


def states(*told: tuple[float, dict[str, Any]]) -> Said:
    return [(key("robot/r1/state"), t_s, RobotState(robot="r1", **fields)) for t_s, fields in told]


def battery(voltage_v: float = 20.0, current_a: float = 2.0, **fields: Any) -> BatteryState:
    told = {"temperature_c": 20.0, "soc": 0.5, "remaining_j": 1e5, **fields}
    return BatteryState(voltage_v=voltage_v, current_a=current_a, **told)


def events(*told: tuple[float, TaskState, dict[str, Any]]) -> Said:
    task = Task(id="t1", kind="visit", place=Point2D(1.0, 2.0))
    return [(key("task/event/t1"), t_s, TaskEvent(task=task, state=state, **fields)) for t_s, state, fields in told]


# -- robots -----------------------------------------------------------------------------------------------------


def test_where_a_robot_was_and_its_charge_are_kept_with_gaps_where_it_did_not_know(path: Path) -> None:
    first = {"pose": Pose2D(1.0, 2.0, 0.0), "battery": battery(soc_sd=0.1)}
    robot = gathered(path, states((0.0, first), (1.0, {}))).robots["r1"]
    assert list(robot.t_s) == [0.0, 1.0]
    assert (robot.x_m[0], robot.y_m[0], robot.soc[0], robot.soc_sd[0]) == (1.0, 2.0, 0.5, 0.1)
    assert np.isnan([robot.x_m[1], robot.y_m[1], robot.soc[1], robot.soc_sd[1]]).all()


def test_measured_energy_is_what_the_battery_gave_since_the_state_before(path: Path) -> None:
    said = states((0.0, {"battery": battery(20.0, 2.0)}), (0.1, {"battery": battery(1.0, 1.0)}),
                  (0.5, {"battery": battery(10.0, 1.0)}), (5.5, {}), (6.0, {}))  # fmt: skip
    robot = gathered(path, said).robots["r1"]
    assert list(robot.measured_j) == pytest.approx([0.0, 20.0, 70.0, 70.0])
    assert list(robot.predicted_j) == pytest.approx([0.0, 20.0, 70.0, 70.0])  # it has no model


def test_energy_is_not_reckoned_over_a_gap(path: Path) -> None:
    said = states((0.0, {"battery": battery()}), (5.1, {"battery": battery()}), (6.1, {"battery": battery()}))
    assert list(gathered(path, said).robots["r1"].measured_j) == pytest.approx([0.0, 0.0, 40.0])


# -- the team, the map and motes --------------------------------------------------------------------------------


def test_the_map_is_merged_and_a_patch_that_does_not_fit_is_left_out(path: Path) -> None:
    said = []
    for width, rows in ((4, 2), (4, 1), (9, 9)):
        grid = OccupancyGrid(GridGeometry(0.5, 0.0, 0.0, width, width))
        grid.merge_patch(0, 0, np.full((rows, 3), FREE, np.int8), 1)
        patch = PatchCells(0, 0, grid.classes(), 1)
        said.append((key("robot/r1/map"), float(len(said)), to_message("r1", grid.geometry, patch)))
    run = gathered(path, said)
    assert run.map.grid is not None
    assert run.map.grid.known_count == 6


def test_what_went_wrong_until_the_end_of_the_run_is_told(path: Path) -> None:
    said = states((0.0, {"lost": "kidnapped"}), (1.0, {}), (1.5, {}))
    run = gathered(path, [*said, (key("coordinator/state"), 9.0, TeamState(robots=[]))])
    found = [(one.kind, one.start_s, one.end_s) for one in run.happenings]
    assert found == [("astray", 0.0, 1.0), ("silent", 1.5, None)]


def test_what_does_not_decode_or_is_not_of_the_wire_is_left_out(path: Path) -> None:
    said: Said = [("elsewhere", 0.0, b"{}"), (key("robot/r1/state"), 1.0, b"[]"), *states((2.0, {}))]
    assert list(gathered(path, said).robots["r1"].t_s) == [2.0]


# -- tasks ------------------------------------------------------------------------------------------------------


def test_a_task_that_changes_hands_has_a_span_for_each_robot(path: Path) -> None:
    said = events(
        (0.0, TaskState.QUEUED, {}),
        (1.0, TaskState.RUNNING, {"robot": "r1"}),
        (2.0, TaskState.RUNNING, {"robot": "r1"}),
        (3.0, TaskState.RUNNING, {"robot": "r2"}),
        (4.0, TaskState.QUEUED, {"why": "r2 refused"}),
        (6.0, TaskState.RUNNING, {"robot": "r3"}),
        (8.0, TaskState.FAILED, {"robot": "r3", "why": "wall", "result": {"energy_j": 7}}),
    )
    [task] = gathered(path, said).tasks.values()
    assert task.spans == [("r1", 1.0, 3.0), ("r2", 3.0, 4.0), ("r3", 6.0, 8.0)]
    assert (task.queued_s, task.started_s, task.ended_s) == (0.0, 1.0, 8.0)
    assert (task.name, task.kind, task.state, task.robot, task.reason) == ("t1", "visit", "failed", "r3", "wall")
    assert task.measured_j == 7.0


def test_what_was_predicted_is_the_last_estimate_before_it_began(path: Path) -> None:
    def estimate(t_s: float, energy_j: float) -> tuple[str, float, msgspec.Struct]:
        times = dict.fromkeys(("starts_in_s", "arrives_in_s", "ends_in_s", "ends_low_s", "ends_high_s"), 1.0)
        one = TaskEstimate(task="t1", robot="r1", energy_j=energy_j, **times)
        return key("task/estimates"), t_s, TaskEstimates(tasks=(one,))

    said = [
        estimate(0.0, 10.0),
        estimate(1.0, 20.0),
        *events((2.0, TaskState.RUNNING, {"robot": "r1"})),
        estimate(3.0, 30.0),
        *events((5.0, TaskState.DONE, {"robot": "r1"})),
    ]
    [task] = gathered(path, said).tasks.values()
    assert task.predicted_j == 20.0


@pytest.mark.parametrize("told", [{}, {"energy_j": "much"}, {"energy_j": None}])
def test_what_a_robot_does_not_tell_in_numbers_was_not_measured(path: Path, told: dict[str, Any]) -> None:
    [task] = gathered(path, events((0.0, TaskState.DONE, {"robot": "r1", "result": told}))).tasks.values()
    assert task.measured_j is None
