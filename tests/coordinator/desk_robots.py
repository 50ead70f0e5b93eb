"""Robots with a task desk as real ones have it, that work by the clock, lose touch, are stopped and are killed."""

from robrain.agent.robot_tasks import RobotTasks
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.model.tasks.task import TaskState
from tests.coordinator.conftest import FakeRobot, Team

RESUMED_NS = to_ns(0.5)
"""A process that was stopped may for so long be at what others were given meanwhile: it has yet to hear of it."""


class DeskRobot(FakeRobot):
    """As its team steps it: ten times a second.

    Each task takes `takes_s`, and it says in how long it ends.
    """

    def __init__(self, team: Team, name: str, x_m: float, y_m: float = 4.0) -> None:
        self.takes_s = 4.0
        self.ends_as = TaskState.DONE
        self.tells = True
        """Whether it says in how long its task ends."""
        self.isolated = False
        """Nothing of it arrives anywhere, and nothing at it."""
        self.stopped = False
        self.refuses: set[str] = set()
        self.begun: list[str] = []
        self.done: list[str] = []
        self.done_unheard: set[str] = set()
        """Those of them that it ended within its lease while nothing of it arrived: others may be given them."""
        self.resumed_ns: int | None = None
        self._new_desk()
        super().__init__(team, name, x_m, y_m)
        team.robots.append(self)

    def come(self) -> None:
        super().come()
        self._inbox = Inbox()
        self.wire.subscribe(self._inbox, COORDINATOR_STATE)

    def restart(self) -> None:
        """Its process is killed, and starts again."""
        self._new_desk()
        self.stopped = self.isolated = False
        self.leave()
        self.come()

    def resume(self) -> None:
        """Its process goes on after it was stopped."""
        if self.stopped:
            self.resumed_ns = self._now_ns
        self.stopped = False

    @property
    def is_settled(self) -> bool:
        """Whether it has not just been resumed."""
        return self.resumed_ns is None or self._now_ns - self.resumed_ns > RESUMED_NS

    @property
    def running(self) -> str:
        """The task that it is at; empty if it is at none."""
        task = self.desk.facts.task
        return "" if task is None or task.state.ended else task.id

    @property
    def next(self) -> str:
        """The task that it holds."""
        held = self.desk.facts.next_task
        return "" if held is None else held.id

    def say_state(self) -> None:
        if self.stopped:
            return
        now_ns = self._now_ns
        for received in self._inbox.drain():
            if not self.isolated:
                self.desk.renew_lease(received.message, self.name, now_ns)
        if self.halted:
            self.desk.halted()
        self.desk.check_lease(now_ns)
        if self.running and now_ns >= self._until_ns and self.is_settled:
            if self.ends_as is TaskState.DONE:
                self.done.append(self.running)
                if self.isolated:
                    self.done_unheard.add(self.running)
            self.desk.end(self.running, self.ends_as, "so it went")
        self.desk.go_on(now_ns)
        if self.isolated:
            return
        standing = self.desk.situation(now_ns)
        self.task = standing.task
        super().say_state(next_task=standing.next_task, task_before=standing.before)

    @property
    def _now_ns(self) -> int:
        return self._team.clock.now_ns()

    def _new_desk(self) -> None:
        self.desk = RobotTasks(lambda: [self.name])
        for kind in ("visit", "explore", "recharge"):
            self.desk.register(kind, self._begin, lambda _why: None)

    def _begin(self, task) -> TaskAnswer:
        if task.id in self.refuses or not self.accepts:
            return TaskAnswer(accepted=False, why="no way there")
        self.begun.append(task.id)
        self._until_ns = self._now_ns + to_ns(self.takes_s)
        if self.tells and task.kind != "explore":
            self.desk.foresee(task.id, self._until_ns)
        return TaskAnswer(accepted=True)

    def _offered(self, request) -> TaskAnswer:
        offer = request.asked
        self._check_reachable()
        self.offers.append(offer)
        if self.halted:
            return TaskAnswer(accepted=False, why="the robot is halted")
        answer = self.desk.offer(offer, self._now_ns)
        if not self.answers:  # it has taken it, and nobody hears of that
            raise CallError(ErrorCode.TIMEOUT, "no reply in time")
        return answer

    def _withdrawn(self, request) -> TaskAnswer:
        self._check_reachable()
        self.withdrawals.append(request.asked)
        return self.desk.withdraw(self.withdrawals[-1])

    def _check_reachable(self) -> None:
        if self.isolated or self.stopped:
            raise CallError(ErrorCode.TIMEOUT, "no reply in time")
