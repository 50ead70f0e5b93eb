"""A bench: plugins are written into a folder as a student would, and run in lockstep on a robot of their own."""

import logging
import textwrap
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh

from robrain.agent.authoring.testing import HostBench
from robrain.agent.host.agent_host import AgentHost, stock_place
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.agent.manifest import find_manifests
from robrain.agent.plugin import Plugin
from robrain.protocol.errors import CallError
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.wire.endpoint import Drive

PRELUDE = """
from typing import Protocol
import msgspec
from robrain.agent.errors import *
from robrain.agent.event import Event
from robrain.agent.plugin import Behavior, Device, Skill, Unit, external
"""


class Bench(HostBench):
    """A folder with plugins, and the robots that run them."""

    def __init__(self, place: Path, session: zenoh.Session) -> None:
        super().__init__(session)
        self.place = place

    def code(self, module: str, source: str) -> None:
        """Write `module`.py; plugin bases and the like are imported already."""
        (self.place / f"{module}.py").write_text(PRELUDE + textwrap.dedent(source), encoding="utf-8")

    def manifest(
        self, name: str, class_path: str, parameters: dict[str, Any] | None = None, **tag: bool | list[str]
    ) -> Path:
        """Write `name`.toml."""
        path = self.place / f"{name}.toml"
        tables = {"plugin": {"class": class_path}, "parameters": parameters or {}, "tag": tag}
        path.write_text(_as_toml(tables), encoding="utf-8")
        return path

    def add(self, robot_file: RobotFile, *, seed: int = 0) -> AgentHost:
        """A host for a robot, not yet started; it does not search what is installed."""
        host = AgentHost(robot_file, Path(), self.session, self.clock, Drive.LOCKSTEP, seed=seed, **stock_alone())
        self.hosts.append(host)
        return host

    def host(
        self, *load: str, robot: str = "r1", seed: int = 0, parameters: dict[str, dict[str, Any]] | None = None
    ) -> AgentHost:
        """A robot that loads these plugins, not yet started."""
        table = RobotTable(robot, places=[str(self.place)], load=list(load))
        return self.add(RobotFile(robot=table, parameters=parameters or {}), seed=seed)

    def start(self, *load: str, **options: Any) -> AgentHost:
        """A robot that loads these plugins, started."""
        host = self.host(*load, **options)
        host.start()
        return host

    def call(self, plugin: str, function: str, arguments: Any = None, robot: str = "r1") -> Any:
        """An external call with arguments as one array or object; the decoded result."""
        reply = self.wire.ask(ROBOT_CALL, arguments, robot=robot, plugin=plugin, function=function)
        return msgspec.json.decode(reply)

    def plugin(self, name: str) -> Any:
        """The instance of the last robot's plugin, looked at from inside."""
        plugin = self.hosts[-1].manager.get(name).plugin
        assert isinstance(plugin, Plugin)
        return plugin


def stock_alone() -> dict[str, Any]:
    """For an `AgentHost`: the plugins of robrain, found once a process, and none of other distributions."""
    return {"distributions": [], "manifests": {stock_place(): list(_stock_manifests())}}


@cache
def _stock_manifests() -> list[Path]:
    return find_manifests(stock_place())


def refused(call: Callable[..., object], /, *args: Any, **kwargs: Any) -> CallError:
    """The error with which a call is refused."""
    with pytest.raises(CallError) as refusal:
        call(*args, **kwargs)
    return refusal.value


def _as_toml(tables: dict[str, dict[str, Any]]) -> str:
    lines = []
    for table, values in tables.items():
        lines.append(f"[{table}]")
        lines += [f"{key} = {msgspec.json.encode(value).decode()}" for key, value in values.items()]
    return "\n".join(lines)


@pytest.fixture
def bench(tmp_path: Path, session: zenoh.Session, caplog: pytest.LogCaptureFixture) -> Iterator[Bench]:
    caplog.set_level(logging.WARNING)
    bench = Bench(tmp_path, session)
    yield bench
    bench.close()
