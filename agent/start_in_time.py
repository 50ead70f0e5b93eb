"""A plugin that hangs while it is started is left behind: the robot goes on without it."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from robrain.agent.crew import Crew, NotBack
from robrain.agent.errors import PluginHung

if TYPE_CHECKING:
    from robrain.agent.tag import PluginTag


def start_in_time(crew: Crew, tag: "PluginTag", do: Callable[[], object]) -> None:
    """Run a plugin's own code to import, start or replace it, for as long as its manifest's `start_s` allows.

    Raises:
        PluginHung: it does not come back.
        Exception: whatever it raises.

    """
    limit_s = tag.manifest.tag.start_s
    error = crew.run({tag.name: do}, limit_s).get(tag.name)
    if isinstance(error, NotBack):
        why = f"{tag.name} has not come back from its start for {limit_s:g} s"
        left = tag.give_up_start(why)
        if left is not None and isinstance(crew.run({tag.name: left}, limit_s).get(tag.name), NotBack):
            tag.abandon(why)
        raise PluginHung(tag.name, why)
    if error is not None:
        raise error
