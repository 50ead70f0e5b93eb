"""Desk robots that have consensus switched on, and a coordinator that is killed and returns."""

from collections import Counter

import msgspec

from robrain.agent.board import Board
from robrain.agent.consensus.consensus import REPORTING, Consensus
from robrain.agent.consensus.holders import GOES_ON_S
from robrain.coordinator.journal.journal import Journal
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.consensus_messages import ROBOT_BALLOT
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from tests.coordinator.conftest import Team
from tests.coordinator.desk_robots import DeskRobot


class TeamRobot(DeskRobot):
    """A desk robot with a consensus desk, as a host has it."""

    hears_only_mates = False

    def come(self) -> None:
        super().come()
        self.board = Board()
        self.board.pose = self.pose
        self.clock, self.follows = self.wire.clock, lambda _summary: True
        self.consensus = Consensus(self, [])
        self._send = self.consensus._publisher.put
        self.consensus._publisher.put = lambda message: None if self.isolated else self._send(message)

    def say_state(self) -> None:
        if self.stopped:
            return
        if self.isolated:
            self.consensus._inbox.drain()
        if self.hears_only_mates:
            self._inbox.drain()
            self.consensus._inbox = _OnlyMates(self.consensus._inbox)
        self.consensus.step(self._now_ns, may_begin=not self.halted)
        states, self._states = self._states, self
        super().say_state()
        self._states = states

    def put(self, state: RobotState) -> None:
        """The state as its host would complete it."""
        self._team_states.put(msgspec.structs.replace(state, continues_for_s=GOES_ON_S))

    @property
    def _team_states(self):
        if not hasattr(self, "_publisher"):
            self._publisher = self.wire.publisher(ROBOT_STATE, robot=self.name)
        return self._publisher

    def _offered(self, request) -> TaskAnswer:
        self._check_reachable()
        reason = self.consensus.offer_refusal(request.asked.task.id, self._now_ns)
        return super()._offered(request) if reason is None else TaskAnswer.refused(reason)

    def _withdrawn(self, request) -> TaskAnswer:
        self._check_reachable()
        if self.consensus.is_reporting(self._now_ns):
            return TaskAnswer.refused(REPORTING)
        return super()._withdrawn(request)


class _OnlyMates:
    """An inbox that what a coordinator says does not reach, for one step."""

    has_some = True

    def __init__(self, inbox) -> None:
        self.inbox = inbox.inbox if isinstance(inbox, _OnlyMates) else inbox

    def drain(self):
        return [received for received in self.inbox.drain() if received.topic is ROBOT_BALLOT]


class _Nobody:
    """What steps where a coordinator was."""

    def step(self) -> None:
        """Do nothing."""


class LostTeam(Team):
    """A team of robots with consensus; its coordinator can be killed."""

    def __init__(self, session, robots: int) -> None:
        super().__init__(session)
        self.journal = Journal()
        self.begin(self.journal)
        for number in range(robots):
            TeamRobot(self, f"r{number + 1}", 4.0 + number)
        self.closed_room()
        self.run(1.5)

    def kill(self) -> None:
        """The coordinator ends without a word."""
        self._coordinator_wire.close()
        self._coordinator_wire = None
        self.coordinator = _Nobody()

    def revive(self) -> None:
        """Another one begins, on the same journal."""
        self.begin(self.journal)

    def visits(self, count: int) -> list[str]:
        names = [f"t{number}" for number in range(count)]
        for number, name in enumerate(names):
            self.submit(
                Task(id=name, kind="visit", place=Point2D(3.5 + 0.5 * (number % 10), 3.0 + 0.5 * (number // 10)))
            )
        return names

    @property
    def done(self) -> Counter[str]:
        """How often each task was done, by any robot."""
        return Counter(name for robot in self.robots for name in robot.done if name.startswith("t"))

    @property
    def begun(self) -> Counter[str]:
        return Counter(name for robot in self.robots for name in robot.begun if name.startswith("t"))
