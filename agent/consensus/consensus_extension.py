"""The host extension of consensus: it allocates tasks without a coordinator if the robot's file says so."""

from functools import partial

import msgspec

from robrain.agent.consensus.consensus_desk import TELLING, ConsensusDesk, chargers_in
from robrain.agent.consensus.holders import GOES_ON_S
from robrain.agent.host.host_extension import ExtendedHost, HostExtension
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.consensus_messages import DropTaken, TaskTaken
from robrain.protocol.messages.tasks.task_messages import TaskRequest, TaskSubmission
from robrain.protocol.reasons import OfferRefusal
from robrain.protocol.table.topics import ROBOT_CANCEL, ROBOT_SUBMIT
from robrain.protocol.wire.endpoint import Request, Serve


def consensus_extension(host: ExtendedHost) -> HostExtension:
    """Consensus for a robot whose file says `consensus = true`; for others an extension that refuses tasks."""
    return ConsensusExtension(host) if host.robot_file.robot.consensus else NoConsensus(host)


class ConsensusExtension(HostExtension):
    """Has a robot's ConsensusDesk stepped, asked and reported."""

    def __init__(self, host: ExtendedHost) -> None:
        chargers = chargers_in(host.robot_file.parameters)
        self.desk = ConsensusDesk(host.wire, host.name, host.board, host.desk, chargers, host.follows)
        self._host = host

    def start(self) -> None:
        """Answer clients that find no coordinator."""
        wire, robot = self._host.wire, self._host.name
        wire.answer(ROBOT_SUBMIT, self._submit, serve=Serve.IN_STEP, robot=robot)
        wire.answer(ROBOT_CANCEL, self._cancel, serve=Serve.IN_STEP, robot=robot)

    def step(self, now_ns: int, *, may_begin: bool) -> None:
        """See ConsensusDesk.step."""
        self.desk.step(now_ns, may_begin=may_begin)

    def offer_refusal(self, task_id: str, now_ns: int) -> OfferRefusal | None:
        """See ConsensusDesk.offer_refusal."""
        return self.desk.offer_refusal(task_id, now_ns)

    def withdrawal_refusal(self, now_ns: int) -> OfferRefusal | None:
        """Refuse while a coordinator is being told what was done without it."""
        return TELLING if self.desk.is_telling(now_ns) else None

    def extend_state(self, state: RobotState) -> RobotState:
        """Report that the robot continues without a coordinator."""
        return msgspec.structs.replace(state, goes_on_s=GOES_ON_S, changes_heard=self.desk.changes_heard)

    def _submit(self, request: Request[TaskSubmission]) -> TaskTaken:
        return self.desk.submit(request.asked, self._host.clock.now_ns())

    def _cancel(self, request: Request[TaskRequest]) -> DropTaken:
        return self.desk.cancel(request.asked, self._host.clock.now_ns())


class NoConsensus(HostExtension):
    """Refuses tasks that clients without a coordinator submit."""

    def __init__(self, host: ExtendedHost) -> None:
        self._host = host

    def start(self) -> None:
        """Answer clients that find no coordinator."""
        wire, robot = self._host.wire, self._host.name
        why = f"{robot} has its tasks from a coordinator alone: its file has no `consensus = true`"
        wire.answer(ROBOT_SUBMIT, partial(_refuse_task, why), serve=Serve.IN_STEP, robot=robot)
        wire.answer(ROBOT_CANCEL, partial(_refuse_cancel, why), serve=Serve.IN_STEP, robot=robot)


def _refuse_task(why: str, request: Request[TaskSubmission]) -> TaskTaken:
    raise CallError(ErrorCode.REFUSED, f"task {request.asked.task.id} is refused: {why}", why)


def _refuse_cancel(why: str, request: Request[TaskRequest]) -> DropTaken:
    raise CallError(ErrorCode.REFUSED, f"task {request.asked.id} is not cancelled: {why}", why)
