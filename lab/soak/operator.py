"""The operator of a fault script: submits, cancels and halts, and asks again until it has an answer."""

from collections.abc import Mapping

from robrain.lab.soak.fault_script import FaultScript, HaltOrder
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE
from robrain.protocol.messages.tasks import task_messages
from robrain.protocol.messages.tasks.task_messages import TaskRecord, TaskRequest, TaskSubmission
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, HALT, Halt
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Endpoint

OPERATOR = "operator"
AGAIN_NS = to_ns(1.0)
REPEATED_NS = to_ns(2.0)
"""`robrain halt` publishes a halt again during this time while a robot has not confirmed it."""
NOT_NOW_S = 0.001
"""Of the wall: within this process an answer is there at once, or with a later step and so when asked again."""
NS_PER_S = 1_000_000_000


class Operator:
    """Follows the script.

    Args:
        wire: the operator's place on the wire.
        script: orders to give.
        repeats: whether a halt is published again to robots that have not confirmed it, as `robrain halt` does. Without
            that only the coordinator publishes it to them.

    """

    def __init__(self, wire: Endpoint, script: FaultScript, *, repeats: bool = False) -> None:
        self.acknowledged: dict[str, int] = {}
        """Time of the coordinator's acknowledgement of each task, ns."""
        self.refused: dict[str, str] = {}
        """Tasks that it has refused for good, with its words."""
        self.cancelled: dict[str, int] = {}
        """Time of the acknowledgement of each cancellation, ns."""
        self.asked_to_cancel: set[str] = set()
        """Tasks whose cancellation was requested, answered or not."""
        self.halt: HaltOrder | None = None
        """The halt that is in force, by its own messages."""
        self._wire = wire
        self._after = {order.task.id: order.task.after for order in script.tasks}
        self._submits = sorted(script.tasks, key=lambda order: order.at_s)
        self._cancels = sorted(script.cancels, key=lambda order: order.at_s)
        self._halts = sorted(script.halts, key=lambda order: order.at_s)
        self._halt_publisher = wire.publisher(HALT)
        self._inbox = Inbox()
        self._halted: dict[str, bool] = {}
        self._is_resuming = False
        self._again_ns = 0
        self._repeats = repeats
        self._sent_ns = 0
        self._robots = wire.watch(ROBOT_ALIVE)
        wire.subscribe(self._inbox, ROBOT_STATE)
        wire.subscribe(self._inbox, COORDINATOR_STATE)

    @property
    def is_content(self) -> bool:
        """Whether all was asked, and answered."""
        return not (self._submits or self._cancels or self._halts or self.halt or self._is_resuming)

    def step(self, now_ns: int) -> None:
        """Send due queries; a query without an answer for a second is sent again."""
        for received in self._inbox.drain():
            message = received.message
            if received.topic is ROBOT_STATE:
                self._halted[message.robot] = message.halted
            else:
                self._halted[""] = message.halt is not None and message.halt.halted
        due_s = now_ns / NS_PER_S
        self._track_halts(now_ns, due_s)
        if now_ns < self._again_ns:
            return
        self._again_ns = now_ns + AGAIN_NS
        if self._is_resuming or (self.halt is None and self._is_team_halted):
            self._resume()
        self._submits = [order for order in self._submits if order.at_s > due_s or not self._submit(order.task, now_ns)]
        self._cancels = [order for order in self._cancels if order.at_s > due_s or not self._cancel(order.task, now_ns)]

    def _submit(self, task: Task, now_ns: int) -> bool:
        if any(name in self.refused for name in task.after):
            self.refused[task.id] = "a task that it waits for was refused"
            return True
        if any(name not in self.acknowledged for name in task.after):
            return False
        try:
            self._wire.ask(task_messages.TASK_SUBMIT, TaskSubmission(task=task, by=OPERATOR), timeout_s=NOT_NOW_S)
        except NobodyThere:
            return False
        except CallError as error:
            is_late = now_ns > task.deadline_ns - to_ns(task.service_s) if task.deadline_ns else False
            if error.code is not ErrorCode.REFUSED or not (is_late or self._waits_for_cancelled(task.after)):
                return False
            self.refused[task.id] = error.message
            return True
        self.acknowledged[task.id] = now_ns
        return True

    def _waits_for_cancelled(self, after: tuple[str, ...]) -> bool:
        """Whether one of these tasks, or one that it waits for, was to be cancelled; others then end as well."""
        before = self._after
        return any(name in self.asked_to_cancel or self._waits_for_cancelled(before.get(name, ())) for name in after)

    def _cancel(self, task_id: str, now_ns: int) -> bool:
        if task_id in self.refused:
            return True
        if task_id not in self.acknowledged:
            return False
        self.asked_to_cancel.add(task_id)
        try:
            asked = TaskRequest(id=task_id, by=OPERATOR, why="the script says so")
            self._wire.ask(task_messages.TASK_CANCEL, asked, timeout_s=NOT_NOW_S)
        except NobodyThere:
            return False
        except CallError as error:
            return error.code is ErrorCode.REFUSED and error.detail in ("done", "failed")
        self.cancelled[task_id] = now_ns
        return True

    def _track_halts(self, now_ns: int, due_s: float) -> None:
        if self.halt is None and self._halts and self._halts[0].at_s <= due_s:
            self.halt = self._halts.pop(0)
            self._is_resuming = False
            self._sent_ns = now_ns
            self._halt_publisher.put(Halt(halted=True, by=OPERATOR, reason="the script says so"))
        elif self.halt is not None and self.halt.until_s <= due_s:
            self.halt = None
            self._is_resuming = True
            self._again_ns = now_ns
        elif self.halt is not None and self._repeats and now_ns - self._sent_ns <= REPEATED_NS and self._is_unheard:
            self._halt_publisher.put(Halt(halted=True, by=OPERATOR, reason="the script says so"))

    def _resume(self) -> None:
        self._halt_publisher.put(Halt(halted=False, by=OPERATOR))
        self._is_resuming = self._is_team_halted

    @property
    def _is_team_halted(self) -> bool:
        """Whether a running component reports to be halted; dead ones are not waited for."""
        there = {"", *self._there()}
        return any(halted and name in there for name, halted in self._halted.items())

    @property
    def _is_unheard(self) -> bool:
        """Whether a robot that is present has not reported the halt."""
        return not all(self._halted.get(name, False) for name in self._there())

    def _there(self) -> set[str]:
        """Names of the robots that are there."""
        if self._robots.arrived:
            self._robots.changes()
        return {names["robot"] for names in self._robots.present.values()}


def breach_reason(operator: Operator, asked: Mapping[str, Task], task_id: str, record: TaskRecord | None) -> str:
    """Reason why an acknowledged task's end was not requested, in one sentence; empty if it was.

    Args:
        operator: sender of the orders.
        asked: every task of the script.
        task_id: the task.
        record: as the coordinator has it at the end of the run.

    """

    def may_fail(name: str) -> bool:
        """Whether a task, or one that it waits for, may end otherwise than done."""
        task = asked[name]
        return task.deadline_ns is not None or name in operator.asked_to_cancel or any(map(may_fail, task.after))

    if record is None:
        return f"{task_id} was acknowledged, and the coordinator does not know it"
    if record.state is TaskState.DONE and task_id in operator.cancelled:
        return f"{task_id} is done, although its cancellation was acknowledged"
    if record.state is TaskState.CANCELLED and task_id not in operator.asked_to_cancel:
        if not any(map(may_fail, asked[task_id].after)):
            return f"{task_id} is cancelled, and nobody asked for that"
    elif record.state is TaskState.FAILED and not may_fail(task_id):
        return f"{task_id} has failed without need: {record.why}"
    return ""
