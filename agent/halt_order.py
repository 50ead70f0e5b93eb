"""The order in which a robot's plugins are halted: calls are refused, then devices stop, then upwards."""

import logging
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from robrain.agent.crew import Crew, run_in_turn
from robrain.agent.plugin import Level
from robrain.agent.plugin_state import PluginState

if TYPE_CHECKING:
    from robrain.agent.tag import PluginTag

logger = logging.getLogger(__name__)


def halt_plugins(robot: str, tags: "Sequence[PluginTag]", crew: Crew | None) -> list[str]:
    """Halt these.

    Args:
        robot: its name, for the log.
        tags: of its plugins.
        crew: halts the plugins of a level side by side and goes on without those that hang; without one they are
            halted one after the other.

    Returns:
        The names of those that failed, or have not come back in time.

    """
    for tag in tags:
        tag.refuse_calls()
    busy = [tag for tag in tags if tag.turn.owner is not None]
    failed: dict[str, BaseException] = {}
    for level in Level:
        calls = {tag.name: tag.halt for tag in tags if tag.level is level}
        failed |= crew.run(calls) if crew is not None else run_in_turn(calls)
    if crew is not None:
        for tag in busy:
            crew.begin(partial(_halt_again, tag))
    for name, error in failed.items():
        logger.error("%s: plugin %s failed while it was halted: %s", robot, name, error, exc_info=error)
    return list(failed)


def _halt_again(tag: "PluginTag") -> None:
    """Once more, when whoever was in the plugin has left: what they did last may have undone the halt."""
    turn, generation = tag.turn, tag.generation
    if not turn.acquire(tag.manifest.tag.hang_s):
        return  # it hangs, and is faulted for it
    turn.release()
    if tag.state is PluginState.HALTED and tag.generation == generation:
        tag.halt()
