"""The robot's log: faults, halts, and the output and log of its plugins."""

import logging
import sys
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import chain
from types import FrameType
from typing import TextIO, cast

import msgspec
import zenoh

from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.plugin import Plugin
from robrain.agent.plugin_output import PluginLogs, PluginOutput, PluginStream
from robrain.agent.plugin_traceback import is_of_host
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG, LogRecord
from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.wire.endpoint import Endpoint, Request

KEPT_LINES = 200
"""Lines that are kept of each plugin or part."""


class RobotLog:
    """Publishes the robot's log, and keeps its last lines. May be called on any thread.

    Args:
        wire: the host's endpoint.
        robot: name of the robot.

    """

    def __init__(self, wire: Endpoint, robot: str) -> None:
        self._robot, self._clock = robot, wire.clock
        self._publisher = wire.publisher(ROBOT_LOG, robot=robot)
        self._kept: dict[str, deque[LogRecord]] = {}
        self._putting = threading.Lock()

    def put(self, source: str, level: str, text: str) -> None:
        """Add a line, of a plugin or part of the robot."""
        record = LogRecord(robot=self._robot, level=level, source=source, text=cut(text, TEXT_MAX))
        with self._putting, suppress(zenoh.ZError):  # the session is closing
            stamp_ns = self._clock.now_ns()
            kept = self._kept.setdefault(source, deque(maxlen=KEPT_LINES))
            kept.append(msgspec.structs.replace(record, stamp_ns=stamp_ns))
            self._publisher.put(record, stamp_ns)

    def kept(self, _request: Request[None]) -> list[LogRecord]:
        """The last lines of each plugin and part, oldest first."""
        with self._putting:
            return sorted(chain(*self._kept.values()), key=lambda record: record.stamp_ns)

    @contextmanager
    def plugin_output(self) -> Iterator[PluginOutput]:
        """Add the output and logs of plugins while the block runs; the process prints them as well."""
        output = PluginOutput(self.put, plugin_here, self._clock)
        root, logs, streams = logging.getLogger(), PluginLogs(output), (sys.stdout, sys.stderr)
        logs.addFilter(lambda record: hasattr(record, "plugin") or not is_of_host(record.pathname))
        level, levels = root.level, [(handler, handler.level) for handler in root.handlers]
        for handler in root.handlers:
            handler.setLevel(max(handler.level, level))
        root.setLevel(min(level, logs.level))
        root.addHandler(logs)
        sys.stdout, sys.stderr = (cast(TextIO, PluginStream(stream, output)) for stream in streams)
        try:
            yield output
        finally:
            sys.stdout, sys.stderr = streams
            root.removeHandler(logs)
            root.setLevel(level)
            for handler, own_level in levels:
                handler.setLevel(own_level)


def plugin_here() -> str:
    """Name of the plugin whose code runs on this thread; empty if none.

    It is that of the innermost method on the stack that is a plugin's, or the host's for a plugin.
    """
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_varnames[:1] == ("self",):
            owner = frame.f_locals.get("self")
            if isinstance(owner, ManagedPlugin):
                return owner.name
            if isinstance(owner, Plugin) and hasattr(owner, "env"):
                return owner.env.plugin
        frame = frame.f_back
    return ""
