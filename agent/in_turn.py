"""A behavior's dealings with the task desk, in the behavior's own turn."""

from typing import TYPE_CHECKING

from robrain.agent.plugin_state import PluginState
from robrain.agent.task_desk import Accept, LetGo
from robrain.protocol.model.task import Task
from robrain.protocol.wire.messages import TaskAnswer

if TYPE_CHECKING:
    from robrain.agent.tag import PluginTag


def in_turn(tag: "PluginTag", accept: Accept, let_go: LetGo) -> tuple[Accept, LetGo]:
    """The same two, called with the plugin's lock held and, `accept`, only while it is active; what raises faults."""

    def accept_in_turn(task: Task) -> TaskAnswer:
        try:
            with tag.turn:
                if tag.state is not PluginState.ACTIVE:
                    return TaskAnswer(accepted=False, why=f"{tag.name} is {tag.state}")
                return accept(task)
        except Exception as error:  # noqa: BLE001 - foreign plugin code
            tag.blame(error)
            return TaskAnswer(accepted=False, why=f"{tag.name} is {tag.state}: {tag.why or error}")

    def let_go_in_turn(why: str) -> None:
        try:
            with tag.turn:
                let_go(why)
        except Exception as error:  # noqa: BLE001 - foreign plugin code
            tag.blame(error)

    return accept_in_turn, let_go_in_turn
