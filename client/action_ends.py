"""Waits for the ends of long actions of a robot's plugin."""

import msgspec

from robrain.client.members import no_robot, team_found
from robrain.client.transport import Transport
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.robots.action_messages import ActionEnd
from robrain.protocol.wire.topics import ROBOT_EVENT

FINISHED = "finished"
"""Name of the event by which plugins report the ends of their actions; see `agent/action.py`."""
POLL_S = 0.02
PRESENCE_S = 1.0
"""Period of the check that the robot is still there."""


class ActionEnds:
    """Ends of one plugin's actions, from its creation on: create it before an action is started.

    Args:
        transport: to the team.
        wire: a new endpoint, closed by its owner.
        robot: name of the robot.
        plugin: name of the plugin.

    """

    def __init__(self, transport: Transport, wire: Endpoint, robot: str, plugin: str) -> None:
        self._transport, self._wire, self._robot, self._plugin = transport, wire, robot, plugin
        self._inbox = Inbox()
        wire.subscribe(self._inbox, ROBOT_EVENT, robot=robot, plugin=plugin, event=FINISHED)

    def end_of(self, action: str, timeout_s: float | None = None) -> ActionEnd:
        """Wait for the end of an action.

        Raises:
            NobodyThere: the robot has gone.
            TimeoutError: the action has not ended in time.

        """
        transport = self._transport
        began_s = transport.elapsed_s()
        check_s = began_s + PRESENCE_S
        while True:
            for received in self._inbox.drain():
                value = received.message.value
                if isinstance(value, dict) and value.get("action") == action:
                    return msgspec.convert(value, ActionEnd)
            now_s = transport.elapsed_s()
            if timeout_s is not None and now_s - began_s >= timeout_s:
                raise TimeoutError(f"{self._robot}: {action} of {self._plugin} has not ended after {timeout_s:g} s")
            if now_s >= check_s:
                if self._robot not in team_found(self._wire).robots:
                    raise no_robot(self._wire, self._robot, action)
                check_s = now_s + PRESENCE_S
            transport.pass_time(POLL_S)
