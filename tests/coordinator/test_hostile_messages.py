"""Messages that no robot sends: the coordinator rejects and counts them, and continues."""

import msgspec
import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.coordinator.leadership.leadership import Leadership
from robrain.coordinator.motes.mote_members import MoteMembers
from robrain.coordinator.parts.charging import Charging
from robrain.coordinator.parts.exploration import Exploration
from robrain.coordinator.team.roster import ROBOTS_UNSEEN_MAX
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import OCCUPIED, GridGeometry
from robrain.protocol.model.tasks.task import Task, TaskState

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 120, 80)
DAY_MS = 24 * 3600 * 1000


def state(**fields) -> bytes:
    return msgspec.json.encode({"robot": "r1", **fields})


@pytest.mark.parametrize(
    "said",
    [state(pose={"x_m": 1e308, "y_m": 0.0, "yaw_rad": 0.0}), state(task={"id": "t", "epoch": -1, "state": "done"})],
)
def test_a_state_with_absurd_numbers_is_refused_and_the_team_goes_on(team, said):
    robot = team.robot("r1")
    team.hall()
    team.run(0.5)
    team.endpoint().publisher(ROBOT_STATE, robot="r1").put_bytes(said)
    team.run(1.0)
    assert robot.task is not None
    assert [(one.topic, one.code, one.count) for one in team.summary.refused] == [("robot_state", "malformed", 1)]


@pytest.mark.sets_aside
def test_one_state_that_cannot_be_handled_is_set_aside_and_the_others_count(team, monkeypatch):
    for name in ("r1", "r2", "r3"):
        team.robot(name)
    note = team.coordinator.roster.record_state

    def faulty(said, now_ns):
        if said.robot == "r2":
            raise ZeroDivisionError("a defect")
        note(said, now_ns)

    monkeypatch.setattr(team.coordinator.roster, "record_state", faulty)
    team.run(1.0)
    summary = team.summary
    assert [robot.up for robot in summary.robots] == [True, False, True]
    (found,) = summary.refused
    assert found.code == "failed"
    assert found.why.endswith(": ZeroDivisionError: a defect")
    assert found.key.endswith("robot/r2/state")


STAGES = {
    "answers": (lambda core: core.lifecycle, "process_answers"),
    "halts": (lambda core: core.halts, "receive"),
    "tasks": (lambda core: core.lifecycle, "settle"),
    "MoteMembers": (lambda core: core.parts.find(MoteMembers), "decide"),
    "planning": (lambda core: core.planning, "step"),
    "withdrawals": (lambda core: core.lifecycle, "withdraw_strays"),
    "offers": (lambda core: core.executor, "step"),
    "Charging": (lambda core: core.parts.find(Charging), "assign"),
    "Exploration": (lambda core: core.parts.find(Exploration), "assign"),
    "Leadership": (lambda core: core.parts.find(Leadership), "check"),
}
NEEDED = ("planning", "offers")
"""Without these stages no task is given to a robot."""


@pytest.mark.sets_aside
@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_that_raises_is_set_aside_and_the_others_run(team, monkeypatch, stage):
    team.robot("r1")
    team.hall()
    team.run(0.5)
    owner, function = STAGES[stage]

    def faulty(*_args, **_options):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(owner(team.coordinator.core), function, faulty)
    team.submit(Task(id="v1", kind="visit", place=Point2D(6.0, 4.0)))
    team.run(1.0)
    summary = team.summary
    assert ("stage", stage, "failed") in [(one.topic, one.key, one.code) for one in summary.refused]
    assert [robot.up for robot in summary.robots] == [True]
    assert team.states() == {"v1": TaskState.QUEUED if stage in NEEDED else TaskState.RUNNING}


# -- invented robots ------------------------------------------------------------------------------------------


def test_invented_robots_are_few_forgotten_and_counted(team):
    team.robot("r1")
    team.run(0.5)
    forger = team.endpoint()
    for number in range(400):
        name = f"ghost{number:03}"
        forger.publisher(ROBOT_STATE, robot=name).put(RobotState(robot=name))
    team.run(0.6)
    summary = team.summary
    assert len(summary.robots) == 1 + ROBOTS_UNSEEN_MAX < 50
    assert {one.code for one in summary.refused} == {"unknown_sender"}
    assert team.coordinator._wire.refusals.total == 400 - ROBOTS_UNSEEN_MAX
    team.run(15.0)
    assert [robot.name for robot in team.summary.robots] == ["r1"]


# -- invented maps --------------------------------------------------------------------------------------------


def forged(robot, observed_ms, kind=OCCUPIED):
    cells = np.full((GEOMETRY.height, GEOMETRY.width), kind, np.int8)
    return to_message(robot, GEOMETRY, PatchCells(0, 0, cells, observed_ms))


@pytest.mark.parametrize(
    ("robot", "patch", "code", "why"),
    [
        ("r1", forged("r1", 20_000), "not_plausible", "claims to be observed 19.0 s from now"),
        ("r1", forged("r1", 900), "not_plausible", "occupied"),  # more walls than it can have seen
        (
            "ghost",
            to_message("ghost", GEOMETRY, PatchCells(0, 0, np.zeros((20, 20), np.int8), 900)),
            "unknown_sender",
            "",
        ),
    ],
    ids=["future", "walls", "ghost"],
)
def test_an_invented_patch_changes_nothing(team, robot, patch, code, why):
    team.explore()
    known_m2 = team.summary.known_area_m2
    team.endpoint().publisher(ROBOT_MAP, robot=robot).put(patch)
    team.run(4.0 if "future" in why else 0.6)
    summary = team.summary
    assert (summary.known_area_m2, summary.all_explored) == (known_m2, False)
    (found,) = summary.refused
    assert (found.topic, found.code) == ("robot_map", code)
    assert why in found.why


# -- forged epochs --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ahead_ms", [5_000, DAY_MS])
def test_an_epoch_from_the_future_is_outbid_at_once_and_told(team, ahead_ms, monkeypatch):
    robot = team.robot("r1")
    refuse_offers_below(team, robot, ahead_ms, monkeypatch)
    team.hall()
    team.run(2.0)
    assert robot.task is not None
    assert robot.task.epoch > ahead_ms
    (found,) = team.summary.refused
    assert (found.topic, found.key, found.code) == ("robot_offer", "r1", "old_epoch")


def refuse_offers_below(team, robot, newest, monkeypatch):
    offered = robot._offered

    def answer(request):
        offer = request.asked
        if offer.epoch < newest:
            return TaskAnswer(accepted=False, why="older", epoch=newest)
        return offered(request)

    robot.leave()
    monkeypatch.setattr(robot, "_offered", answer)
    robot.come()


def test_an_epoch_of_a_coordinator_that_came_later_is_not_outbid_but_told(team, monkeypatch):
    robot = team.robot("r1")
    refuse_offers_below(team, robot, 50, monkeypatch)
    team.hall()
    team.run(0.2)
    monkeypatch.setattr(robot, "_offered", robot._offered)
    team.run(2.0)
    assert robot.task is None
    (found,) = team.summary.refused
    assert found.code == "old_epoch"
    assert found.why == "it accepted epoch 50 from another coordinator; if there is none, restart this one"


def test_an_epoch_that_no_robot_accepts_does_not_drive_the_coordinator_out_of_range(team, monkeypatch):
    robot = team.robot("r1")
    refuse_offers_below(team, robot, 2**53 - 1, monkeypatch)
    team.hall()
    team.run(2.0)
    assert team.coordinator.tasks.journal.new_epoch() < DAY_MS
    (found,) = team.summary.refused
    assert (found.code, found.why) == ("old_epoch", f"it reports epoch {2**53 - 1}, which no robot accepts")
