"""Robot r1 with its consensus desk; a coordinator and teammates say what a test has them say."""

from typing import Any

from robrain.agent.board import Board
from robrain.agent.consensus.consensus import Consensus
from robrain.agent.robot_tasks import RobotTasks
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.consensus_messages import ROBOT_BALLOT, TeamBallot
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskAnswer, TaskEvent
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, RobotSummary, TeamState
from robrain.protocol.model.ballot import Ballot, SeenBallot
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session

STEP_S = 0.1
CHARGERS = [Point2D(9.0, 9.0), Point2D(1.0, 1.0)]


def visit(name: str, x_m: float = 2.0, **fields: Any) -> Task:
    return Task(**{"id": name, "kind": "visit", "place": Point2D(x_m, 0.0), **fields})


class OneRobot:
    """Robot r1 with its desk; a coordinator and teammates say what a test has them say."""

    def __init__(self) -> None:
        self.session = open_lockstep_session()
        self.clock, self.name, self.follows = VirtualClock(), "r1", lambda _summary: True
        self.wire = Endpoint(self.session, "test", self.clock, Drive.LOCKSTEP)
        self.board, self.desk = Board(), RobotTasks()
        self.board.pose = Pose2D(0.0, 0.0, 0.0)
        self.begun: list[str] = []
        for kind in ("visit", "recharge"):
            self.desk.register(kind, self._accept, lambda _why: None)
        self.consensus = Consensus(self, CHARGERS)
        self.says: dict[str, dict[str, Any]] = {}
        """What each teammate says with each step."""
        self.is_coordinated, self.last_change = True, 0
        self._ballots = {name: self.wire.publisher(ROBOT_BALLOT, robot=name) for name in ("r2", "r3")}
        self._summaries, self._events = self.wire.publisher(COORDINATOR_STATE), self.wire.publisher(TASK_EVENT)
        self._inbox = Inbox(every=True)
        self.wire.subscribe(self._inbox, ROBOT_BALLOT, robot="r1")
        self._said: list[TeamBallot] = []

    def _accept(self, task: Task) -> TaskAnswer:
        self.begun.append(task.id)
        return TaskAnswer(accepted=True)

    def run(self, seconds: float, *, team: tuple[str, ...] = ("r1", "r2", "r3")) -> list[TeamBallot]:
        """What the robot says meanwhile."""
        for _ in range(round(seconds / STEP_S)):
            self.clock.advance_to(self.clock.now_ns() + to_ns(STEP_S))
            if self.is_coordinated:
                robots = [RobotSummary(name=name, up=True, age_s=0.1) for name in team]
                self._summaries.put(TeamState(robots=robots, last_change=self.last_change))
            for received in self._inbox.drain():
                self._said.append(received.message)
            echo = tuple(SeenBallot(robot="r1", number=ballot.ballot.number) for ballot in self._said[-1:])
            for number, (name, words) in enumerate(self.says.items()):
                said = Ballot(robot=name, number=self.clock.now_ns() // 1000 + number)
                self._ballots[name].put(TeamBallot(robot=name, ballot=said, **{"receives": echo, **words}))
            self.consensus.step(self.clock.now_ns(), may_begin=True)
        said, self._said = [*self._said, *(received.message for received in self._inbox.drain())], []
        return said

    def tell(self, task: Task, state: TaskState = TaskState.QUEUED, robot: str = "") -> None:
        self._events.put(TaskEvent(task=task, state=state, robot=robot))

    def close(self) -> None:
        self.wire.close()
        self.session.close()


def alone(one: OneRobot, **words: Any) -> None:
    """No coordinator any more, and two teammates."""
    one.run(1.0)
    one.is_coordinated = False
    one.says = {"r2": dict(words), "r3": {}}
    one.run(2.0)


def free(one: OneRobot) -> list[str]:
    return [task.id for task in one.consensus._free(one.clock.now_ns())]
