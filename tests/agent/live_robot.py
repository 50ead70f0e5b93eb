"""A robot that runs live on threads of the test's process, and an operator who asks it; both reach nobody else."""

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import run_agent
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.protocol.clock import LiveClock
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_PLUGINS, PluginInfo
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.session import open_lockstep_session
from tests.agent.conftest import stock_alone
from tests.patient_endpoint import PatientEndpoint
from tests.waiting import PATIENCE_S, until


class LiveRobot:
    """The robot r1 with the plugins of one place. `ready` is set once all of them run or are left out.

    Args:
        place: the folder with their manifests.
        load: their names.
        space_of: a plugin with a function `press`, in whose module the test's events are; its `GO` lets go what hangs.
        threads: how the names of threads begin that must be gone after `close`.

    """

    def __init__(self, place: Path, load: Sequence[str], *, space_of: str, threads: str) -> None:
        self._space_of, self._threads = space_of, threads
        self.session = open_lockstep_session()
        robot_file = RobotFile(robot=RobotTable("r1", places=[str(place)], load=list(load)))
        self.host = AgentHost(robot_file, place, self.session, LiveClock(), Drive.LIVE, **stock_alone())
        self.wire = PatientEndpoint(self.session, "default", LiveClock(), Drive.LIVE)
        self._stopping, self.ready = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=run_agent, args=(self.host, self._stopping.is_set, self.ready.set))
        self._thread.start()

    @property
    def space(self) -> dict[str, Any]:
        """The names of the plugins' module."""
        names: dict[str, Any] = self.tag(self._space_of).plugin_class.press.__globals__
        return names

    def tag(self, plugin: str) -> Any:
        return self.host.manager.get(plugin)

    def plugin(self, name: str) -> Any:
        return self.tag(name).plugin

    def infos(self) -> dict[str, PluginInfo]:
        infos = self.wire.ask(ROBOT_PLUGINS, robot="r1")
        return {info.name: info for info in infos}

    def call(self, plugin: str, function: str) -> Any:
        return self.wire.ask(ROBOT_CALL, robot="r1", plugin=plugin, function=function)

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def close(self) -> None:
        """End the robot, and see that it leaves no thread behind."""
        self.space["GO"].set()
        self.stop()
        self.wire.close()
        self.session.close()
        until(lambda: not any(thread.name.startswith(self._threads) for thread in threading.enumerate()))
