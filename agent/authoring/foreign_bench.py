"""A bench for plugins in separate processes, in any language: a live hub, and their robot's host.

def test_gauge_reads_a_temperature():
    with ForeignBench(["./gauge", "r1"], plugin="gauge") as bench:
        assert 19.0 < bench.call("read") < 21.0
"""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self, TypeVar

import msgspec

from robrain.agent.isolation.foreign_plugins import ForeignPlugins
from robrain.agent.plugin import Level
from robrain.protocol.clock import LiveClock
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.robots.plugin_messages import ROBOT_FOREIGN_CALL, PluginInfo
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import CONNECT_VARIABLE
from robrain.protocol.wire.session import listening_at, open_session
from robrain.protocol.workers import ProcessGroup

T = TypeVar("T")

PATIENCE_S = 60.0
"""Longest wait for a process that starts or ends."""
POLL_S = 0.005


class ForeignBench:
    """Starts a process and waits until it has announced its plugin; use it in a `with` block.

    Args:
        command: words of the command. It gets the team's endpoint in $ROBRAIN_CONNECT.
        plugin: name of the plugin that it announces.
        robot: name of the robot that it joins.

    """

    def __init__(self, command: Sequence[str | Path], *, plugin: str, robot: str = "r1") -> None:
        self.plugin = plugin
        self.robot = robot
        self.process: ProcessGroup
        """The process, while the block lasts."""
        self._command = command
        self._open = ExitStack()
        self._wire: Endpoint
        self._plugins: ForeignPlugins

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            hub = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
            opening.callback(hub.close)
            self._wire = Endpoint(hub, DEFAULT_TEAM, LiveClock(), Drive.LIVE)
            opening.callback(self._wire.close)
            self._plugins = ForeignPlugins(self._wire, self.robot)
            environment = {CONNECT_VARIABLE: ",".join(listening_at(hub))}
            self.process = ProcessGroup(self._command, environment=environment)
            opening.callback(self.process.kill)
            self._until(lambda: self.plugin in self._plugins, "has not announced its plugin")
            self._open = opening.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def info(self) -> PluginInfo:
        """The plugin as its process describes it."""
        return next(info for info in self._plugins.infos() if info.name == self.plugin)

    def call(self, function: str, arguments: object = None) -> Any:
        """Call a function as from outside the robot, through its host.

        Args:
            function: its name.
            arguments: a list by position, a dict by name; bytes are sent as they are.

        Raises:
            CallError: the call is refused, or the plugin fails; the text gives the reason.

        """
        payload = arguments if isinstance(arguments, bytes) else b"" if arguments is None else _json(arguments)
        return msgspec.json.decode(self._plugins.relay(self.plugin, function, payload))

    def call_directly(self, function: str, arguments: object = None) -> Any:
        """Call a function of the process itself, past the robot's host and its checks (errors as those of `call`).

        Raises:
            NobodyThere: the process is gone.

        """
        payload = None if arguments is None else _json(arguments)
        reply = self._wire.ask(ROBOT_FOREIGN_CALL, payload, robot=self.robot, plugin=self.plugin, function=function)
        return msgspec.json.decode(reply)

    def use(self, interface: type[T], *, caller: str = "driver", level: Level = Level.UNIT) -> T:
        """A handle as another plugin of the robot gets it.

        Args:
            interface: Protocol that the caller requires.
            caller: name of that plugin.
            level: its level.

        Raises:
            AccessDenied: the level, the visibility or the interface does not allow it.

        """
        return self._plugins.use(caller, level, self.plugin, interface)

    def kill(self) -> None:
        """Kill the process and wait until the robot has noticed."""
        self.process.kill()
        self._until(lambda: self.plugin not in self._plugins, "is still listed")

    def _until(self, is_so: Callable[[], bool], trouble: str) -> None:
        ends_s = time.monotonic() + PATIENCE_S
        while not is_so():
            if time.monotonic() > ends_s:
                raise TimeoutError(f"{self.plugin} of {self.robot} {trouble} after {PATIENCE_S:g} s")
            self._plugins.follow()
            time.sleep(POLL_S)


def _json(arguments: object) -> bytes:
    return msgspec.json.encode(arguments)
