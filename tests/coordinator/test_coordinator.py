import itertools
import logging
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest
import zenoh

from robrain.coordinator.coordinator import LEASE_S, Coordinator
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.occupancy_grid import FREE, OCCUPIED, GridGeometry, OccupancyGrid, PatchCells
from robrain.protocol.model.task import TaskState
from robrain.protocol.wire.clock import VirtualClock, to_ns
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.map_patch import to_message
from robrain.protocol.wire.messages import (
    RobotState,
    TaskAnswer,
    TaskEvent,
    TaskOffer,
    TaskStatus,
    TaskWithdrawal,
    TeamState,
)
from robrain.protocol.wire.session import open_lockstep_session
from robrain.protocol.wire.topics import (
    COORDINATOR_STATE,
    ROBOT_ALIVE,
    ROBOT_MAP,
    ROBOT_MAP_WHOLE,
    ROBOT_OFFER,
    ROBOT_STATE,
    ROBOT_WITHDRAW,
    TASK_EVENT,
)

TICK_S = 0.02
GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 120, 80)
NEXT = {
    None: {TaskState.QUEUED},
    TaskState.QUEUED: {TaskState.OFFERED},
    TaskState.OFFERED: {TaskState.RUNNING, TaskState.CANCELLED},
    TaskState.RUNNING: {TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED, TaskState.LOST_CONTACT},
    TaskState.LOST_CONTACT: {TaskState.RUNNING, TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED},
}


class FakeRobot:
    """A robot as the wire knows it: token, states, map, answers to offers."""

    def __init__(self, team: "Team", name: str, x_m: float, y_m: float) -> None:
        self.name = name
        self.pose = Pose2D(x_m, y_m, 0.0)
        self.speaks = True
        self.halted = False
        self.accepts = True
        self.task: TaskStatus | None = None
        self.offers: list[TaskOffer] = []
        self.withdrawals: list[TaskWithdrawal] = []
        self.grid = OccupancyGrid(GEOMETRY)
        self._team = team
        self.come()

    def come(self) -> None:
        """Join the wire; its own map and task are as they were."""
        self.wire = Endpoint(self._team.session, "default", self._team.clock, Drive.LOCKSTEP)
        self._states = self.wire.publisher(ROBOT_STATE, robot=self.name)
        self._maps = self.wire.publisher(ROBOT_MAP, robot=self.name)
        self.wire.answer(ROBOT_OFFER, self._offered, robot=self.name)
        self.wire.answer(ROBOT_WITHDRAW, self._withdrawn, robot=self.name)
        self.wire.answer(ROBOT_MAP_WHOLE, lambda _request: self._whole(), robot=self.name)
        self.wire.token(ROBOT_ALIVE, robot=self.name)

    def leave(self) -> None:
        self.wire.close()

    def say_state(self) -> None:
        self._states.put(RobotState(robot=self.name, pose=self.pose, radius_m=0.2, task=self.task, halted=self.halted))

    def say_map(self, geometry: GridGeometry, cells: PatchCells) -> None:
        self._maps.put(to_message(self.name, geometry, cells))

    def end(self, state: TaskState, why: str = "") -> None:
        self.task = msgspec.structs.replace(self.task, state=state, why=why)

    @property
    def goal(self) -> Point2D:
        return self.offers[-1].task.goal

    def _offered(self, request) -> TaskAnswer:
        offer = msgspec.json.decode(request.payload, type=TaskOffer)
        self.offers.append(offer)
        if not self.accepts:
            return TaskAnswer(accepted=False, why="no way there")
        self.task = TaskStatus(id=offer.task.id, epoch=offer.epoch, state=TaskState.RUNNING)
        return TaskAnswer(accepted=True)

    def _withdrawn(self, request) -> TaskAnswer:
        self.withdrawals.append(msgspec.json.decode(request.payload, type=TaskWithdrawal))
        if self.task is not None and self.task.id == self.withdrawals[-1].id:
            self.end(TaskState.CANCELLED, "withdrawn")
        return TaskAnswer(accepted=True)

    def _whole(self):
        patch = self.grid.full_patch()
        return None if patch is None else to_message(self.name, GEOMETRY, patch)


class Team:
    """A coordinator with fake robots, in lockstep."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.clock = VirtualClock()
        self.robots: list[FakeRobot] = []
        self._endpoints: list[Endpoint] = []
        ears = self._endpoint()
        self._events, self._summaries = Inbox(100_000, every=True), Inbox(100_000, every=True)
        ears.subscribe(self._events, TASK_EVENT)
        ears.subscribe(self._summaries, COORDINATOR_STATE)
        self.heard: list[TaskEvent] = []
        self.coordinator = Coordinator(self._endpoint())
        self._ticks = 0
        self._stamp_ms = 0

    def robot(self, name: str, x_m: float = 6.0, y_m: float = 4.0) -> FakeRobot:
        self.robots.append(FakeRobot(self, name, x_m, y_m))
        return self.robots[-1]

    def draw(self, x0: float, y0: float, x1: float, y1: float, kind: int = FREE) -> None:
        """The first robot has seen a box of the floor, metres."""
        row, column = GEOMETRY.cell_of(x0 + 0.05, y0 + 0.05)
        self._stamp_ms += 1
        cells = np.full((round(10 * (y1 - y0)), round(10 * (x1 - x0))), kind, np.int8)
        self.robots[0].say_map(GEOMETRY, PatchCells(row, column, cells, self._stamp_ms))

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / TICK_S)):
            self._ticks += 1
            self.clock.advance_to(to_ns(self._ticks * TICK_S))
            for robot in self.robots:
                if robot.speaks and self._ticks % 5 == 0:
                    robot.say_state()
            self.coordinator.step()
            self.heard += [received.message for received in self._events.drain()]

    @property
    def summary(self) -> TeamState:
        """The last one; the coordinator must have said one since the last look."""
        return self._summaries.drain()[-1].message

    def history(self, task_id: str) -> list[TaskState]:
        return [event.state for event in self.heard if event.task.id == task_id]

    def why(self, task_id: str) -> str:
        return [event.why for event in self.heard if event.task.id == task_id][-1]

    def _endpoint(self) -> Endpoint:
        self._endpoints.append(Endpoint(self.session, "default", self.clock, Drive.LOCKSTEP))
        return self._endpoints[-1]

    def close(self) -> None:
        for robot in self.robots:
            robot.leave()
        for endpoint in self._endpoints:
            endpoint.close()


@pytest.fixture
def team() -> Iterator[Team]:
    with open_lockstep_session() as session:
        team = Team(session)
        yield team
        team.close()
        # Whatever the test was about: tasks only ever change in legal order.
        states: dict[str, TaskState] = {}
        for event in team.heard:
            assert event.state in NEXT[states.get(event.task.id)], (event, states.get(event.task.id))
            states[event.task.id] = event.state


def hall(team: Team) -> None:
    """The middle of a hall is known, all around it is not."""
    team.draw(4.0, 2.0, 8.0, 6.0)


def corridor(team: Team) -> None:
    """A walled corridor, of which two ends are unknown."""
    team.draw(3.0, 3.2, 9.0, 4.8)
    team.draw(3.0, 3.1, 9.0, 3.2, OCCUPIED)
    team.draw(3.0, 4.8, 9.0, 4.9, OCCUPIED)


def closed_room(team: Team) -> None:
    """Nothing unknown is left."""
    team.draw(3.0, 2.0, 9.0, 6.0)
    team.draw(2.9, 1.9, 9.1, 2.0, OCCUPIED)
    team.draw(2.9, 6.0, 9.1, 6.1, OCCUPIED)
    team.draw(2.9, 1.9, 3.0, 6.1, OCCUPIED)
    team.draw(9.0, 1.9, 9.1, 6.1, OCCUPIED)


# -- handing out --------------------------------------------------------------------------------------------


def test_each_idle_robot_is_handed_a_frontier_of_its_own(team):
    robots = [team.robot(f"r{number}", 5.0 + 0.6 * number) for number in range(4)]
    hall(team)
    team.run(1.0)
    goals = [(robot.goal.x_m, robot.goal.y_m) for robot in robots]
    assert len(set(goals)) == 4
    assert [len(robot.offers) for robot in robots] == [1, 1, 1, 1]
    assert len({offer.epoch for robot in robots for offer in robot.offers}) == 4
    assert all(robot.offers[0].lease_s == LEASE_S for robot in robots)
    assert all(
        team.history(robot.task.id) == [TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING] for robot in robots
    )


def test_frontiers_of_one_round_are_apart_from_those_of_the_last(team):
    first = team.robot("r1", 5.8)
    corridor(team)
    team.run(1.0)
    second = team.robot("r2", 5.8)
    team.run(1.0)
    assert abs(first.goal.x_m - second.goal.x_m) > 4.0


def test_a_robot_that_is_done_gets_the_next_frontier_at_once(team):
    robot = team.robot("r1")
    hall(team)
    team.run(1.0)
    robot.end(TaskState.DONE)
    team.run(0.1)
    assert team.history(robot.offers[0].task.id)[-1] is TaskState.DONE
    assert len(robot.offers) == 2
    assert robot.offers[1].epoch > robot.offers[0].epoch
    team.run(1.0)
    summary = team.summary
    assert (summary.tasks_done, summary.tasks_open) == (1, 1)


def test_a_halted_robot_is_offered_nothing(team):
    robot = team.robot("r1")
    robot.halted = True
    hall(team)
    team.run(2.0)
    assert robot.offers == []
    robot.halted = False
    team.run(1.0)
    assert len(robot.offers) == 1


def test_a_robot_that_does_not_know_where_it_is_is_offered_nothing(team):
    robot = team.robot("r1")
    pose, robot.pose = robot.pose, None
    hall(team)
    team.run(2.0)
    assert robot.offers == []
    robot.pose = pose
    team.run(1.0)
    assert len(robot.offers) == 1


def test_a_refused_place_is_offered_to_another_and_not_again_for_a_while(team):
    robot = team.robot("r1")
    robot.accepts = False
    corridor(team)
    team.run(10.0)
    places = [offer.task.goal for offer in robot.offers]
    assert len(places) == 2
    assert places[0] != places[1]
    assert team.why(robot.offers[0].task.id) == "r1 refused: no way there"
    assert team.history(robot.offers[0].task.id)[-1] is TaskState.CANCELLED
    other = team.robot("r2")
    team.run(1.0)
    assert other.goal in places
    team.run(8.0)
    assert len(robot.offers) > 2


def test_a_place_where_a_robot_failed_is_shunned_by_it_for_fifteen_seconds(team):
    robot = team.robot("r1", 4.0)
    corridor(team)
    team.run(1.0)
    west = robot.goal
    robot.end(TaskState.FAILED, "the way is blocked")
    team.run(1.0)
    assert team.why(robot.offers[0].task.id) == "the way is blocked"
    assert robot.goal.x_m > 8.0
    robot.end(TaskState.DONE)
    team.run(12.0)
    assert all(offer.task.goal != west for offer in robot.offers[1:])
    team.run(2.5)
    robot.end(TaskState.DONE)
    team.run(1.0)
    assert robot.goal == west


def test_a_robot_that_nobody_answers_for_costs_its_task_only(team, caplog):
    robot = team.robot("r1")
    deaf = team.robot("r2", 5.0)
    deaf.leave()
    deaf.wire = Endpoint(team.session, "default", team.clock, Drive.LOCKSTEP)
    deaf._states = deaf.wire.publisher(ROBOT_STATE, robot="r2")
    deaf.wire.token(ROBOT_ALIVE, robot="r2")
    hall(team)
    team.run(1.0)
    assert len(robot.offers) == 1
    refused = [event for event in team.heard if event.robot == "r2" and event.state is TaskState.CANCELLED]
    assert refused
    assert "nobody answers" in refused[0].why


# -- losing and finding robots --------------------------------------------------------------------------------


def test_a_lost_robots_task_is_lost_contact_then_cancelled_and_its_frontier_goes_to_another(team):
    lost, other = team.robot("r1", 4.0), team.robot("r2", 8.0)
    corridor(team)
    team.run(1.0)
    task, west = lost.task.id, lost.goal
    other.end(TaskState.DONE)
    team.run(0.5)
    lost.speaks = False
    team.run(2.0)
    assert team.history(task)[-1] is TaskState.LOST_CONTACT
    assert team.why(task).startswith("lost contact")
    other.end(TaskState.FAILED, "elsewhere, then")
    team.run(2.0)
    assert team.history(task)[-1] is TaskState.LOST_CONTACT
    team.run(2.0)
    assert team.history(task)[-2:] == [TaskState.LOST_CONTACT, TaskState.CANCELLED]
    assert team.why(task) == "the lease ran out"
    assert team.history(task).count(TaskState.LOST_CONTACT) == 1
    team.run(1.0)
    assert other.goal == west


def test_a_robot_that_left_is_gone_and_its_task_is_cancelled_after_the_lease(team):
    robot = team.robot("r1")
    hall(team)
    team.run(1.0)
    task = robot.task.id
    robot.speaks = False
    robot.leave()
    team.run(0.1)
    assert team.history(task)[-1] is TaskState.LOST_CONTACT
    assert team.why(task) == "gone"
    team.run(LEASE_S)
    assert team.history(task)[-1] is TaskState.CANCELLED
    robot.come()


def test_a_robot_that_returns_within_its_lease_goes_on(team):
    robot = team.robot("r1")
    hall(team)
    team.run(1.0)
    task = robot.task.id
    robot.speaks = False
    team.run(3.0)
    robot.speaks = True
    team.run(1.0)
    assert team.history(task)[-2:] == [TaskState.LOST_CONTACT, TaskState.RUNNING]
    assert team.why(task) == "it is back"
    robot.end(TaskState.DONE)
    team.run(0.2)
    assert team.history(task)[-1] is TaskState.DONE


def test_a_robot_that_ended_its_task_while_it_was_out_of_reach_is_believed(team):
    robot = team.robot("r1")
    hall(team)
    team.run(1.0)
    task = robot.task.id
    robot.speaks = False
    team.run(3.0)
    robot.end(TaskState.DONE)
    robot.speaks = True
    team.run(0.2)
    assert team.history(task)[-2:] == [TaskState.LOST_CONTACT, TaskState.DONE]


def test_a_robot_that_speaks_without_its_token_does_not_flicker(team):
    """Liveliness may come back later than the rest."""
    robot = team.robot("r1")
    hall(team)
    team.run(1.0)
    task = robot.task.id
    robot.leave()
    robot.wire = Endpoint(team.session, "default", team.clock, Drive.LOCKSTEP)
    robot._states = robot.wire.publisher(ROBOT_STATE, robot="r1")
    team.run(3.0)
    assert team.history(task)[2:] == [TaskState.RUNNING, TaskState.LOST_CONTACT]
    robot.wire.token(ROBOT_ALIVE, robot="r1")
    team.run(0.5)
    assert team.history(task)[-1] is TaskState.RUNNING


def test_a_robot_that_returns_after_its_lease_with_its_old_task_is_told_to_stop(team):
    robot = team.robot("r1")
    hall(team)
    team.run(1.0)
    old = robot.task
    robot.speaks = False
    team.run(8.0)
    assert team.history(old.id)[-1] is TaskState.CANCELLED
    robot.accepts = False  # nothing new takes the old task's place
    robot.speaks = True
    team.run(1.0)
    assert [(withdrawal.id, withdrawal.epoch) for withdrawal in robot.withdrawals] == [(old.id, old.epoch)]
    assert robot.task.state is TaskState.CANCELLED


def test_a_robot_that_forgot_its_task_in_a_restart_gets_another(team):
    robot = team.robot("r1")
    hall(team)
    team.run(1.0)
    forgotten = robot.task.id
    robot.task = None
    robot.leave()
    robot.come()
    team.run(0.5)
    assert team.history(forgotten)[-1] is TaskState.RUNNING
    team.run(1.0)
    assert team.history(forgotten)[-1] is TaskState.CANCELLED
    assert team.why(forgotten) == "r1 knows nothing of it"
    assert robot.offers[-1].task.id != forgotten
    assert robot.task.state is TaskState.RUNNING
    assert robot.withdrawals == []


def test_a_running_task_is_not_withdrawn(team):
    robot = team.robot("r1")
    hall(team)
    team.run(5.0)
    assert robot.withdrawals == []
    assert robot.task.state is TaskState.RUNNING


def test_a_coordinator_that_takes_over_offers_with_greater_epochs(team):
    robot = team.robot("r1")
    hall(team)
    team.run(5.0)
    before = robot.offers[-1].epoch
    robot.grid.merge_patch(20, 40, np.full((40, 40), FREE, np.int8), 5)
    team.coordinator = Coordinator(team._endpoint())
    # Zenoh tells of tokens that were there before on a thread of its own, a little later.
    for _ in range(100):
        team.run(0.5)
        if robot.withdrawals:
            break
    assert robot.withdrawals
    assert robot.offers[-1].epoch > before
    ids = [offer.task.id for offer in robot.offers]
    assert len(set(ids)) == len(ids)


# -- the map --------------------------------------------------------------------------------------------------


def test_a_coordinator_that_comes_late_asks_for_the_whole_map(team):
    robot = FakeRobot(team, "r1", 6.0, 4.0)
    robot.grid.merge_patch(20, 40, np.full((40, 40), FREE, np.int8), 5)
    team.robots.append(robot)
    team.run(1.0)
    assert team.coordinator.team_map.known_area_m2 == pytest.approx(16.0)
    assert len(robot.offers) == 1


def test_patches_on_another_grid_are_refused_with_one_line_in_the_log(team, caplog):
    team.robot("r1")
    stranger = team.robot("r2", 5.0)
    hall(team)
    team.run(0.5)
    version = team.coordinator.team_map.version
    for _ in range(5):
        cells = PatchCells(0, 0, np.full((5, 5), FREE, np.int8), 900)
        stranger.say_map(GridGeometry(0.05, 0.0, 0.0, 50, 50), cells)
        team.run(0.2)
    refused = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert [record.getMessage().split(" cannot")[0] for record in refused] == ["the map of r2"]
    assert team.coordinator.team_map.version == version
    assert team.coordinator.team_map.grid.geometry == GEOMETRY


# -- telling --------------------------------------------------------------------------------------------------


def test_the_summary_says_who_is_there_and_what_is_known(team):
    team.robot("r1")
    silent = team.robot("r2", 5.0)
    silent.speaks = False
    hall(team)
    team.run(2.0)
    summary = team.summary
    assert [(robot.name, robot.up) for robot in summary.robots] == [("r1", True), ("r2", False)]
    assert summary.robots[1].why == "nothing heard yet"
    assert summary.known_area_m2 == pytest.approx(16.0)
    assert summary.frontiers
    assert (summary.tasks_open, summary.tasks_done, summary.all_explored) == (1, 0, False)
    assert summary.messages >= 15


def test_the_summary_comes_twice_a_second(team):
    team.robot("r1")
    team.run(0.1)
    team._summaries.drain()
    team.run(10.0)
    stamps = [received.message.stamp_ns for received in team._summaries.drain()]
    assert len(stamps) == pytest.approx(20, abs=1)
    assert all(after - before == to_ns(0.5) for before, after in itertools.pairwise(stamps))


def test_all_is_explored_when_for_three_seconds_nobody_could_be_sent_anywhere(team):
    team.robot("r1")
    closed_room(team)
    team.run(2.5)
    assert not team.summary.all_explored
    team.run(1.5)
    assert team.summary.all_explored


def test_what_is_explored_is_so_no_longer_when_a_door_is_found(team):
    robot = team.robot("r1")
    closed_room(team)
    team.run(5.0)
    assert team.summary.all_explored
    team.draw(8.9, 3.5, 9.1, 4.5)
    team.run(1.0)
    assert not team.summary.all_explored
    assert len(robot.offers) == 1


def test_as_long_as_a_robot_is_at_work_not_all_is_explored(team):
    robot = team.robot("r1")
    hall(team)
    team.run(1.0)
    closed_room(team)
    team.run(10.0)
    assert not team.summary.all_explored
    robot.end(TaskState.DONE)
    team.run(5.0)
    assert team.summary.all_explored


def test_as_long_as_a_failure_may_be_tried_again_not_all_is_explored(team):
    robot = team.robot("r1")
    robot.accepts = False
    corridor(team)
    team.run(12.0)
    assert not team.summary.all_explored


def test_an_empty_map_is_not_explored_however_late_it_fills(team):
    team.robot("r1")
    team.run(20.0)
    assert not team.summary.all_explored
    closed_room(team)
    team.run(2.0)
    assert not team.summary.all_explored
    team.run(2.0)
    assert team.summary.all_explored


def test_with_no_robot_up_nothing_is_explored(team):
    robot = team.robot("r1")
    closed_room(team)
    team.run(5.0)
    assert team.summary.all_explored
    robot.speaks = False
    team.run(5.0)
    assert not team.summary.all_explored
