"""A robot's side for isolated plugins under test: what a tag would give them, on the test's own thread."""

import textwrap
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec

from robrain.agent.board import Board
from robrain.agent.errors import AccessDenied
from robrain.agent.event import Mailbox
from robrain.agent.isolation.isolated_plugin import Limits, isolated_class
from robrain.agent.lifecycle.plugin_code import import_code
from robrain.agent.manifest import TagTable, read_manifest
from robrain.protocol.wire.endpoint import Drive
from tests.waiting import PATIENCE_S

PRELUDE = """
import ctypes, logging, os, re, threading, time
from typing import Any, Protocol
import msgspec
import numpy as np
from numpy.typing import NDArray
from robrain.agent.errors import *
from robrain.agent.event import Event
from robrain.agent.plugin import Behavior, Device, Skill, Unit, external
from robrain.protocol.model.geometry import Point2D, Pose2D
"""


PATIENT = Limits(call_s=PATIENCE_S, start_s=PATIENCE_S, halt_s=PATIENCE_S)
"""Generous limits for tests that are not about limits, so that slow machines pass too."""


class StandInEnvironment:
    """What the isolated plugin uses of its environment."""

    def __init__(self, drive: Drive = Drive.LIVE, connect: tuple[str, ...] = (), seed: int = 7) -> None:
        self.plugin = "vision"
        self.robot = "r1"
        self.connect = list(connect)
        self.wire = SimpleNamespace(drive=drive, team="default")
        self.seeds = (seed,)
        self.board = Board()
        self.mailbox = Mailbox()
        self.others: dict[str, Any] = {}
        self.asked: list[tuple[str, type]] = []
        self.arrived = threading.Event()
        self.mailbox.wake = self.arrived.set

    def use(self, name: str, interface: type) -> Any:
        self.asked.append((name, interface))
        if name not in self.others:
            raise AccessDenied(name, f"vision is not in the visibility of {name}")
        return self.others[name]

    def observe(self, event: Any, function: Any) -> None:
        event.add(function, self.mailbox)


class IsolationBench:
    """A folder for code, and the isolated plugins that were made of it."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self.env = StandInEnvironment()
        self.plugins: list[Any] = []

    def make(self, source: str, *, limits: Limits | None = None, parameters: Any = None, tag: str = "") -> Any:
        """An isolated plugin of the class Vision in `source`, not yet initialised."""
        module = f"vision_{len(self.plugins)}"
        (self.place / f"{module}.py").write_text(PRELUDE + textwrap.dedent(source), encoding="utf-8")
        path = self.place / "vision.toml"
        path.write_text(f'[plugin]\nclass = "{module}:Vision"\n{tag}', encoding="utf-8")
        manifest = read_manifest(path)
        plugin_class = import_code(msgspec.structs.replace(manifest, tag=TagTable())).plugin_class
        isolated: Any = isolated_class(plugin_class, manifest)
        isolated._limits = limits or PATIENT
        given = msgspec.convert(parameters or {}, isolated.Parameters)
        plugin = isolated(self.env, given)
        self.plugins.append(plugin)
        return plugin

    def start(self, source: str, **options: Any) -> Any:
        """The same, initialised and active."""
        plugin = self.make(source, **options)
        plugin.init()
        plugin.activate()
        return plugin

    def close(self) -> None:
        for plugin in self.plugins:
            plugin.close()
