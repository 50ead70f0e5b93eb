"""A team as the coordinator hears it: fake robots on a lockstep session."""

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
import numpy as np
import pytest
import zenoh

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid, PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.coordinator.coordinator import Coordinator
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.tasks.task_book import LEGAL
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE
from robrain.protocol.messages.robots import robot_messages
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_PLUGINS, PluginInfo
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState, TaskStatus
from robrain.protocol.messages.tasks import offer_messages
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskEvent, TaskOffer, TaskWithdrawal
from robrain.protocol.messages.tasks.task_messages import TASK_SUBMIT, TaskFilter, TaskRecord, TaskSubmission
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, TeamState
from robrain.protocol.model.energy_model import EnergyModel
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.rules.rule import Rule
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.topic import Query
from robrain.protocol.wire.endpoint import Drive, Endpoint

TICK_S = 0.02
GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 120, 80)


class FakeRobot:
    """A robot as the wire knows it: token, states, map, answers to offers."""

    def __init__(self, team: "Team", name: str, x_m: float, y_m: float) -> None:
        self.name = name
        self.pose = Pose2D(x_m, y_m, 0.0)
        self.speaks = True
        self.halted = False
        self.halted_by: list[str] = []
        self.team_halt_ns = 0
        self.not_halted: list[str] = []
        self.accepts = True
        self.answers = True
        """False: a query finds it, and never gets an answer in time."""
        self.plugins = ["explore", "visit"]
        self.battery: BatteryState | None = None
        self.energy: EnergyModel | None = None
        self.behavior = ""
        self.continues_for_s: float | msgspec.UnsetType = msgspec.UNSET
        """Set: it goes on without a coordinator, and has heard of `changes_received` changes of tasks."""
        self.changes_received: int | msgspec.UnsetType = msgspec.UNSET
        self.chargers: list[Point2D] | None = None
        """None: its host does not tell them."""
        self.start = Point2D(x_m, y_m)
        self.task: TaskStatus | None = None
        self.offers: list[TaskOffer] = []
        self.withdrawals: list[TaskWithdrawal] = []
        self.grid = OccupancyGrid(GEOMETRY)
        self._team = team
        self.come()

    def come(self) -> None:
        """Join the wire; its own map and task are as they were."""
        self.wire = Endpoint(self._team.session, "default", self._team.clock, Drive.LOCKSTEP)
        self._states = self.wire.publisher(robot_messages.ROBOT_STATE, robot=self.name)
        self._maps = self.wire.publisher(ROBOT_MAP, robot=self.name)
        self.wire.answer(offer_messages.ROBOT_OFFER, self._offered, robot=self.name)
        self.wire.answer(offer_messages.ROBOT_WITHDRAW, self._withdrawn, robot=self.name)
        self.wire.answer(ROBOT_MAP_WHOLE, lambda _request: self._whole(), robot=self.name)
        self.wire.answer(ROBOT_PLUGINS, lambda _request: self._plugins(), robot=self.name)
        self.wire.answer(ROBOT_CALL, lambda request: self._called(request.names["function"]), robot=self.name)
        self.wire.token(robot_messages.ROBOT_ALIVE, robot=self.name)

    def leave(self) -> None:
        self.wire.close()

    def say_state(self, **more: Any) -> None:
        self._states.put(
            RobotState(
                robot=self.name,
                pose=self.pose,
                radius_m=0.2,
                task=self.task,
                halted=self.halted,
                halted_by=self.halted_by,
                team_halt_ns=self.team_halt_ns,
                not_halted=self.not_halted,
                battery=self.battery,
                energy=self.energy,
                behavior=self.behavior,
                continues_for_s=self.continues_for_s,
                changes_received=self.changes_received,
                **more,
            )
        )

    def say_map(self, geometry: GridGeometry, cells: PatchCells) -> None:
        self._maps.put(to_message(self.name, geometry, cells))

    def end(self, state: TaskState, why: str = "", **result: float) -> None:
        self.task = msgspec.structs.replace(self.task, state=state, why=why, result=result)

    @property
    def goal(self) -> Point2D:
        return self.offers[-1].task.place

    def _offered(self, request) -> TaskAnswer:
        offer = request.asked
        self.offers.append(offer)
        if not self.answers:
            raise CallError(ErrorCode.TIMEOUT, "no reply in time")
        if not self.accepts:
            return TaskAnswer(accepted=False, why="no way there")
        self.task = TaskStatus(id=offer.task.id, epoch=offer.epoch, state=TaskState.RUNNING)
        return TaskAnswer(accepted=True)

    def _withdrawn(self, request) -> TaskAnswer:
        self.withdrawals.append(request.asked)
        if self.task is not None and self.task.id == self.withdrawals[-1].id:
            self.end(TaskState.CANCELLED, "withdrawn")
        return TaskAnswer(accepted=True)

    def _called(self, function: str) -> Any:
        if self.chargers is None:
            raise CallError(ErrorCode.UNKNOWN_PLUGIN, "there is no home")
        return self.start if function == "start" else [{"x_m": at.x_m, "y_m": at.y_m} for at in self.chargers]

    def _plugins(self) -> list[PluginInfo]:
        names = self.plugins if self.chargers is None else [*self.plugins, "home"]
        return [PluginInfo(name=name, level="behavior", state="active") for name in names]

    def _whole(self):
        patch = PatchCells(0, 0, self.grid.classes(), int(self.grid.stamp_ms.max()))
        return to_message(self.name, GEOMETRY, patch) if self.grid.known_count else None


class Team:
    """A coordinator with fake robots, in lockstep."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.clock = VirtualClock()
        self.robots: list[FakeRobot] = []
        self._endpoints: list[Endpoint] = []
        self._coordinator_wire: Endpoint | None = None
        ears = self.endpoint()
        self._told: dict[int, TaskEvent] = {}
        self._events, self._summaries = Inbox(100_000, every=True), Inbox(100_000, every=True)
        ears.subscribe(self._events, offer_messages.TASK_EVENT)
        ears.subscribe(self._summaries, COORDINATOR_STATE)
        self.heard: list[TaskEvent] = []
        self.asker = self.endpoint()
        self.begin(None)
        self._ticks = 0
        self._stamp_ms = 0

    def begin(
        self,
        journal: Journal | None,
        policy: PlanningPolicy | None = None,
        rules: Sequence[Rule] = (),
        missions: Sequence[Mission] = (),
    ) -> None:
        """A coordinator takes over; the one before has ended, as by a kill: it never says another word."""
        if self._coordinator_wire is not None:
            self._coordinator_wire.close()
        if journal is None:  # one that remembers nothing counts its changes from the start
            self._told.clear()
        self._coordinator_wire = self.endpoint()
        self.coordinator = Coordinator(self._coordinator_wire, journal, policy, rules, missions=missions)

    def submit(self, task: Task, **fields: Any) -> TaskRecord:
        return self.ask(TASK_SUBMIT, TaskSubmission(task=task, **fields))

    def ask(self, topic: Query, request: Any, kind: Any = TaskRecord) -> Any:
        reply = self.asker.ask(topic, request)
        assert topic.reply == kind
        return reply

    def states(self) -> dict[str, TaskState]:
        """Of the tasks that somebody asked for, as the journal has them."""
        records = self.coordinator.tasks.journal.select(TaskFilter())
        return {record.task.id: record.state for record in records}

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
            for received in self._events.drain():
                event = received.message
                if event.change not in self._told:  # a coordinator that starts again tells the last ones again
                    self._told[event.change] = event
                    self.heard.append(event)

    @property
    def summary(self) -> TeamState:
        """The last one; the coordinator must have said one since the last look."""
        return self._summaries.drain()[-1].message

    def history(self, task_id: str) -> list[TaskState]:
        return [event.state for event in self.heard if event.task.id == task_id]

    def why(self, task_id: str) -> str:
        return [event.why for event in self.heard if event.task.id == task_id][-1]

    def endpoint(self) -> Endpoint:
        self._endpoints.append(Endpoint(self.session, "default", self.clock, Drive.LOCKSTEP))
        return self._endpoints[-1]

    def close(self) -> None:
        for robot in self.robots:
            robot.leave()
        for endpoint in self._endpoints:
            endpoint.close()

    def newcomer(self, name: str, x_m: float, y_m: float) -> FakeRobot:
        """A robot that has not spoken yet."""
        return FakeRobot(self, name, x_m, y_m)

    def settle(self, name: str = "r1", x_m: float = 6.0, y_m: float = 4.0) -> FakeRobot:
        """A robot in a closed room, known to the coordinator; nothing is left to explore."""
        robot = self.robot(name, x_m, y_m)
        self.closed_room()
        self.run(1.0)
        return robot

    def explore(self, x_m: float = 6.0) -> FakeRobot:
        """A robot in a hall that it explores."""
        robot = self.robot("r1", x_m)
        self.hall()
        self.run(1.0)
        return robot

    def hall(self) -> None:
        """The middle of a hall is known, all around it is not."""
        self.draw(4.0, 2.0, 8.0, 6.0)

    def corridor(self) -> None:
        """A walled corridor, of which two ends are unknown."""
        self.draw(3.0, 3.2, 9.0, 4.8)
        self.draw(3.0, 3.1, 9.0, 3.2, OCCUPIED)
        self.draw(3.0, 4.8, 9.0, 4.9, OCCUPIED)

    def closed_room(self) -> None:
        """Nothing unknown is left."""
        self.draw(3.0, 2.0, 9.0, 6.0)
        self.draw(2.9, 1.9, 9.1, 2.0, OCCUPIED)
        self.draw(2.9, 6.0, 9.1, 6.1, OCCUPIED)
        self.draw(2.9, 1.9, 3.0, 6.1, OCCUPIED)
        self.draw(9.0, 1.9, 9.1, 6.1, OCCUPIED)


@pytest.fixture
def team(lockstep_session: zenoh.Session) -> Iterator[Team]:
    team = Team(lockstep_session)
    yield team
    team.close()
    # Whatever the test was about: tasks only ever change in legal order.
    states: dict[str, TaskState] = {}
    for event in team.heard:
        assert event.state in LEGAL[states.get(event.task.id)], (event, states.get(event.task.id))
        states[event.task.id] = event.state
