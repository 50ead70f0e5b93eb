"""A bench for tests of plugins: a real host in lockstep, with a clock that the test moves.

def test_lamp_is_bright():
    with PluginBench(Path(__file__).parent) as bench:
        bench.run(2.0)
        assert bench.call("lamp", "brightness") == 3
"""

import contextlib
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec
import zenoh

from robrain.agent.errors import PluginHung
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.agent.manifest import find_manifests, role_in
from robrain.agent.plugin_traceback import end_thread, raised, traceback_in
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_PLUGINS, PluginInfo
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.protocol.workers import OwnedThread

ROBOT = "r1"
TICK_S = 0.02
HANG_CPU_S, HANG_S = 10.0, 120.0
"""A plugin of a `PluginBench` hangs if one call needs this much time of the processor, or of the wall's clock."""
WATCH_S = 0.25


class HostBench:
    """Robots' hosts in lockstep, moved tick by tick. For tests of one plugin use `PluginBench`.

    Args:
        session: of all of them; not closed by the bench.
        team: name of their team.

    """

    def __init__(self, session: zenoh.Session, team: str = DEFAULT_TEAM) -> None:
        self.session = session
        self.clock = VirtualClock()
        self.wire = Endpoint(session, team, self.clock, Drive.LOCKSTEP)
        """Another endpoint on the robots' wire, to subscribe and to ask."""
        self.hosts: list[AgentHost] = []

    def add(self, robot_file: RobotFile, *, seed: int = 0) -> AgentHost:
        """A host for a robot, not yet started."""
        host = AgentHost(robot_file, Path(), self.session, self.clock, Drive.LOCKSTEP, seed=seed)
        self.hosts.append(host)
        return host

    def tick(self, count: int = 1) -> None:
        """Move time on, and let each host take its step."""
        for _ in range(count):
            self.clock.advance_to(self.clock.now_ns() + to_ns(TICK_S))
            for host in self.hosts:
                host.step()

    def call(self, plugin: str, function: str, *arguments: Any, robot: str = ROBOT) -> Any:
        """Call an external function over the wire; the result as JSON has it (CallError if it is refused or fails)."""
        asked = msgspec.json.encode(arguments)
        return msgspec.json.decode(self.wire.ask(ROBOT_CALL, asked, robot=robot, plugin=plugin, function=function))

    def infos(self, robot: str = ROBOT) -> dict[str, PluginInfo]:
        """The plugins that a robot reports over the wire, by name."""
        return {info.name: info for info in self.wire.ask(ROBOT_PLUGINS, robot=robot)}

    def close(self) -> None:
        """Close the hosts, and leave the wire."""
        for host in self.hosts:
            host.close()
        self.wire.close()


class PluginBench:
    """One robot on a separate session, which reaches no other process.

    Args:
        folders: places with the plugins under test; the stock plugins are there as well.
        load: plugins to load, with the plugins that they require; all in `folders` if None.
        parameters: for each plugin, parameters that override its manifest's.
        roles: by plugin: the one that replaces it; those in `folders` with a role do.
        seed: of everything random.

    """

    def __init__(
        self,
        *folders: Path,
        load: Sequence[str] | None = None,
        parameters: Mapping[str, Mapping[str, Any]] | None = None,
        roles: Mapping[str, str] | None = None,
        seed: int = 0,
    ) -> None:
        own = [path for folder in folders for path in find_manifests(folder)]
        roles = {role: path.stem for path in own if (role := role_in(path))} | dict(roles or {})
        wanted = load if load is not None else [role_in(path) or path.stem for path in own]
        places = [str(folder.resolve()) for folder in folders]
        self._robot_file = RobotFile(
            robot=RobotTable(ROBOT, places=places, load=list(wanted), roles=roles),
            parameters={name: dict(values) for name, values in (parameters or {}).items()},
        )
        self._seed = seed
        self._ticks = 0
        self._open = contextlib.ExitStack()
        self._bench: HostBench
        self.clock: VirtualClock
        """The robot's clock."""
        self.host: AgentHost
        """The robot's host, to look at from inside."""
        self.wire: Endpoint
        """Another endpoint on the same wire, to subscribe and to ask."""

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as opening:
            self._bench = HostBench(opening.enter_context(open_lockstep_session()))
            opening.callback(self._bench.close)
            self.clock, self.wire = self._bench.clock, self._bench.wire
            self.host = self._bench.add(self._robot_file, seed=self._seed)
            with self._watched():
                self.host.start()
            self._open = opening.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._open.close()

    def run(self, seconds: float) -> None:
        """Let that much of the robot's time pass, in ticks of 20 ms.

        Raises:
            PluginHung: a plugin does not come back; the text names file and line.

        """
        with self._watched():
            for _ in range(round(seconds / TICK_S)):
                self._ticks += 1
                self._bench.tick()

    def call(self, plugin: str, function: str, *arguments: Any) -> Any:
        """Call an external function over the wire; the result as JSON has it.

        Raises:
            CallError: the call was refused, or the plugin raised; the text gives the reason.
            PluginHung: a plugin does not come back; the text names file and line.

        """
        with self._watched():
            return self._bench.call(plugin, function, *arguments)

    def info(self, plugin: str) -> PluginInfo:
        """A plugin as the robot reports it: its state, and why.

        Raises:
            KeyError: the robot has no such plugin.

        """
        return self._bench.infos()[plugin]

    def plugin(self, name: str) -> Any:
        """The plugin itself, while it is active, for members that are not external.

        Raises:
            PluginMissing, PluginInactive: there is none, or it is not active; the text gives the reason.

        """
        return self.host.manager.get(name).live_plugin()

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        done, hung = threading.Event(), list[PluginHung]()
        watch = OwnedThread("hang-watch", self._watch, threading.get_ident(), done, hung)
        try:
            yield
        finally:
            done.set()
            watch.close()
            if hung:
                raise hung[0]

    def _watch(self, caller: int, done: threading.Event, hung: list[PluginHung]) -> None:
        seen, cpu_s, wall_s = -1, 0.0, 0.0
        while not done.wait(WATCH_S):
            if self._ticks != seen:
                seen, cpu_s, wall_s = self._ticks, time.process_time(), time.monotonic()
            if time.process_time() - cpu_s < HANG_CPU_S and time.monotonic() - wall_s < HANG_S:
                continue
            owners = {plugin.turn.owner: plugin.name for plugin in self.host.manager.plugins.values()}
            thread, name = next(((owner, name) for owner, name in owners.items() if owner is not None), (caller, ROBOT))
            error = PluginHung(name, f"{name} does not come back").with_traceback(traceback_in(thread, None))
            hung.append(PluginHung(name, f"{error}: {raised(error).where}"))
            end_thread(thread)
            seen = -1
