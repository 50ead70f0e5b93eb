"""Calls to the plugins of a robot, and the ends of their long actions."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from robrain.client.members import no_robot, team_found
from robrain.client.requests import ROBOT_TIMEOUT_S, Requests
from robrain.client.transport import Listening, Transport
from robrain.protocol.codec import BAD_PAYLOAD
from robrain.protocol.errors import NobodyThere, WireError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots import plugin_messages
from robrain.protocol.messages.robots.action_messages import ActionEnd
from robrain.protocol.messages.robots.host_messages import (
    HOST_COMMAND,
    HOST_HOLD,
    HOST_LOAD,
    HOST_RELEASE,
    HOST_RELOAD,
    HOST_UNLOAD,
    CommandRequest,
    HoldRequest,
    LoadRequest,
    ReleaseRequest,
    ReloadRequest,
    UnloadRequest,
)
from robrain.protocol.messages.robots.plugin_messages import LogRecord, PluginInfo
from robrain.protocol.wire.endpoint import Endpoint

PluginInfos = list[PluginInfo]
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
        wire.subscribe(self._inbox, plugin_messages.ROBOT_EVENT, robot=robot, plugin=plugin, event=FINISHED)

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


class RobotCalls:
    """Part of `Team`; see there."""

    by: str
    transport: Transport
    _wire: Endpoint
    _requests: Requests
    _listening: Listening
    _held: set[tuple[str, str]]

    def call(
        self,
        robot: str,
        plugin: str,
        function: str,
        *arguments: object,
        named: Mapping[str, object] | None = None,
        timeout_s: float = ROBOT_TIMEOUT_S,
    ) -> Any:
        """Call an external function of a robot's plugin.

        Args:
            robot: name of the robot.
            plugin: name of the plugin.
            function: its external name.
            arguments: by position.
            named: arguments by name, in place of those by position.
            timeout_s: time limit for the result.

        Returns:
            The result, as decoded JSON.

        Raises:
            CallError: the call is refused, or the plugin fails; the text gives the reason.
            NobodyThere: the robot is absent; the text lists the present ones.
            ValueError: arguments are given by position and by name.

        """
        if arguments and named is not None:
            raise ValueError("expected arguments by position or by name, got both")
        by = self.by if (robot, plugin) in self._held else ""
        asked = msgspec.json.encode(arguments if named is None else named)
        names = {"robot": robot, "plugin": plugin, "function": function}
        try:
            reply = self._wire.ask(plugin_messages.ROBOT_CALL, asked, timeout_s=timeout_s, by=by, **names)
        except NobodyThere as error:
            raise no_robot(self._wire, robot, "calls") from error
        try:
            return msgspec.json.decode(reply)
        except BAD_PAYLOAD as error:
            raise WireError(f"{robot} sent an invalid answer: {error}") from error

    def act(
        self,
        robot: str,
        plugin: str,
        function: str,
        *arguments: object,
        named: Mapping[str, object] | None = None,
        timeout_s: float | None = None,
    ) -> ActionEnd:
        """Call a function that starts a long action, such as the driver's `drive`, and wait for the action's end.

        Args:
            robot: name of the robot.
            plugin: name of the plugin.
            function: its external name.
            arguments: by position.
            named: arguments by name, in place of those by position.
            timeout_s: time limit for the action; None for no limit.

        Returns:
            How it ended: `outcome` is done, failed, cancelled or superseded. It is superseded if another call has
            moved the robot; `by` then names the plugin, such as `explore`.

        Raises:
            CallError: the call is refused, or the plugin fails; the text gives the reason.
            NobodyThere: the robot is absent, or has gone.
            TimeoutError: the action has not ended in time.

        """
        with self.action_ends(robot, plugin) as ends:
            return ends.end_of(self.call(robot, plugin, function, *arguments, named=named), timeout_s)

    @contextmanager
    def action_ends(self, robot: str, plugin: str) -> Iterator[ActionEnds]:
        """Ends of a plugin's long actions; open it before the call that starts one."""
        wire = self._listening.open()
        try:
            yield ActionEnds(self.transport, wire, robot, plugin)
        finally:
            self._listening.end(wire)

    def command(self, robot: str, text: str) -> str:
        """Execute a call in the text form, such as `call driver drive(0.5)`; returns the result as text."""
        return self._requests.robot(HOST_COMMAND, CommandRequest(text=text, by=self.by), robot)

    def hold(self, robot: str, plugin: str, *, lease_s: float = 5.0) -> None:
        """Hold an exclusive plugin for at most 60 s; call again before the end to renew the lease.

        Meanwhile no other caller can use it, including plugins of the robot.

        Raises:
            CallError: another holder has it (`busy`), or the plugin does not exist.

        """
        self._requests.robot(HOST_HOLD, HoldRequest(plugin=plugin, by=self.by, lease_s=lease_s), robot)
        self._held.add((robot, plugin))

    def release(self, robot: str, plugin: str) -> bool:
        """Release a held plugin; False if it was not held, or no longer."""
        self._held.discard((robot, plugin))
        return self._requests.robot(HOST_RELEASE, ReleaseRequest(plugin=plugin, by=self.by), robot)

    def plugins(self, robot: str) -> PluginInfos:
        """Return the plugins of a robot with state, functions and, if not running, the reason."""
        return self._requests.robot(plugin_messages.ROBOT_PLUGINS, None, robot)

    def log(self, robot: str, *, follow: bool = False) -> Iterator[LogRecord]:
        """Yield the last lines of a robot's log, and each further one without end if `follow`.

        They are the output and log of its plugins, faults, and halts.

        Raises:
            NobodyThere: the robot is absent; the text lists the present ones.

        """
        wire, inbox = self._listening.open(), Inbox()
        wire.subscribe(inbox, plugin_messages.ROBOT_LOG, robot=robot)
        kept = self._requests.robot(plugin_messages.ROBOT_LOG_KEPT, None, robot)
        return self._listening.until_done(wire, self._log(inbox, kept, follow=follow))

    def _log(self, inbox: Inbox, kept: list[LogRecord], *, follow: bool) -> Iterator[LogRecord]:
        yield from kept
        known = {(record.stamp_ns, record.source) for record in kept}
        while follow:
            for record in (received.message for received in inbox.drain()):
                if (record.stamp_ns, record.source) not in known:
                    yield record
            self.transport.pass_time(POLL_S)

    def load(self, robot: str, plugin: str | Path) -> PluginInfos:
        """Load a plugin into a running robot, with the plugins that it requires.

        Args:
            robot: name of the robot.
            plugin: a plugin in the robot's places, by name; or a folder or manifest on the robot's machine, by its
                absolute path. A `Path` on this machine works if the robot is on the same.

        Raises:
            CallError: it cannot be loaded; the text gives the reason.

        """
        if isinstance(plugin, Path):
            plugin = str(plugin.resolve())
            self.transport.open_folder(robot, Path(plugin))
        return self._requests.robot(HOST_LOAD, LoadRequest(plugin=plugin), robot)

    def unload(self, robot: str, plugin: str, *, cascade: bool = False) -> PluginInfos:
        """Unload a plugin (CallError if others require it); `cascade` unloads those too."""
        return self._requests.robot(HOST_UNLOAD, UnloadRequest(plugin=plugin, cascade=cascade), robot)

    def reload(self, robot: str, plugin: str) -> PluginInfos:
        """Load a new version of a plugin; if it cannot start (CallError), the old one keeps running."""
        return self._requests.robot(HOST_RELOAD, ReloadRequest(plugin=plugin), robot)
