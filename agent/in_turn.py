"""What reaches a plugin from the task desk and from queries, in the plugin's own turn."""

from typing import TYPE_CHECKING, Any

from robrain.agent.errors import FOREIGN_ERRORS, PluginError
from robrain.agent.plugin_state import PluginState
from robrain.agent.task_desk import Accept, LetGo
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.task import Task
from robrain.protocol.wire.endpoint import Handler, Request
from robrain.protocol.wire.errors import CallError, ErrorCode
from robrain.protocol.wire.messages import TaskAnswer
from robrain.protocol.wire.reasons.offers import PluginOut

if TYPE_CHECKING:
    from robrain.agent.environment import Environment
    from robrain.agent.tag import PluginTag


def in_turn(tag: "PluginTag", accept: Accept, let_go: LetGo) -> tuple[Accept, LetGo]:
    """The same two, called with the plugin's lock held and, `accept`, only while it is active; what raises faults."""

    def accept_in_turn(task: Task) -> TaskAnswer:
        try:
            with tag.turn:
                if tag.state is not PluginState.ACTIVE:
                    return TaskAnswer.refused(PluginOut(tag.name, tag.state))
                return accept(task)
        except FOREIGN_ERRORS as error:  # foreign plugin code
            tag.blame(error)
            return TaskAnswer.refused(PluginOut(tag.name, tag.state, cut(tag.why or str(error))))

    def let_go_in_turn(why: str) -> None:
        try:
            with tag.turn:
                let_go(why)
        except FOREIGN_ERRORS as error:  # foreign plugin code
            tag.blame(error)

    return accept_in_turn, let_go_in_turn


def answer_in_turn(tag: "PluginTag", environment: "Environment", handler: Handler[Any, Any]) -> Handler[Any, Any]:
    """The same handler, called with the plugin's lock held and only while this instance is there."""

    def answer(request: Request[Any]) -> Any:
        try:
            with tag.turn:
                if not tag.holds(environment) or tag.state not in (PluginState.ACTIVE, PluginState.HALTED):
                    raise CallError(ErrorCode.INACTIVE, f"{tag.name} is {tag.state}: {tag.why}")
                return handler(request)
        except PluginError as error:
            raise CallError(error.code, str(error)) from error

    return answer
