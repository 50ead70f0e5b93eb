"""The coordinator loses and finds robots."""

import numpy as np

from robrain.coordinator.coordinator import Coordinator
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE
from robrain.protocol.model.grid_geometry import FREE
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint


def test_a_lost_robots_task_is_lost_contact_then_cancelled_and_its_frontier_goes_to_another(team):
    lost, other = team.robot("r1", 4.0), team.robot("r2", 8.0)
    team.corridor()
    team.run(1.0)
    task, west = lost.task.id, lost.goal
    other.end(TaskState.DONE)
    team.run(0.5)
    lost.speaks = False
    team.run(1.2)
    assert team.history(task)[-1] is TaskState.LOST_CONTACT
    assert team.why(task).startswith("lost contact")
    other.end(TaskState.FAILED, "elsewhere, then")
    team.run(0.5)
    assert team.history(task)[-1] is TaskState.LOST_CONTACT
    team.run(0.5)
    assert team.history(task)[-2:] == [TaskState.LOST_CONTACT, TaskState.CANCELLED]
    assert team.why(task) == "r1 is silent, and the lease ran out"
    assert team.history(task).count(TaskState.LOST_CONTACT) == 1
    team.run(1.0)
    assert other.goal == west


def test_a_robot_that_returns_within_its_lease_goes_on(team):
    robot = team.explore()
    task = robot.task.id
    robot.speaks = False
    team.run(1.5)
    robot.speaks = True
    team.run(1.0)
    assert team.history(task)[-2:] == [TaskState.LOST_CONTACT, TaskState.RUNNING]
    assert team.why(task) == "it is back"
    robot.end(TaskState.DONE)
    team.run(0.2)
    assert team.history(task)[-1] is TaskState.DONE


def test_a_robot_that_speaks_without_its_token_does_not_flicker(team):
    """Liveliness may come back later than the rest."""
    robot = team.explore()
    task = robot.task.id
    robot.leave()
    robot.wire = Endpoint(team.session, "default", team.clock, Drive.LOCKSTEP)
    robot._states = robot.wire.publisher(ROBOT_STATE, robot="r1")
    team.run(3.0)
    assert team.history(task)[2:] == [TaskState.RUNNING, TaskState.LOST_CONTACT]
    robot.wire.token(ROBOT_ALIVE, robot="r1")
    team.run(0.5)
    assert team.history(task)[-1] is TaskState.RUNNING


def test_a_coordinator_that_takes_over_offers_with_greater_epochs(team):
    robot = team.robot("r1")
    team.hall()
    team.run(5.0)
    before = robot.offers[-1].epoch
    robot.grid.merge_patch(20, 40, np.full((40, 40), FREE, np.int8), 5)
    team.coordinator = Coordinator(team.endpoint())
    # Zenoh tells of tokens that were there before on a thread of its own, a little later.
    for _ in range(100):
        team.run(0.5)
        if robot.withdrawals:
            break
    assert robot.withdrawals
    assert robot.offers[-1].epoch > before
    ids = [offer.task.id for offer in robot.offers]
    assert len(set(ids)) == len(ids)
