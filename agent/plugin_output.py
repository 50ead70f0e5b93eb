"""Output of plugins: their prints and logs, by line, with a limit for each plugin."""

import logging
import time
from collections.abc import Callable
from typing import Any, TextIO

import msgspec

from robrain.protocol.clock import Clock, to_ns
from robrain.protocol.model.ranges import TEXT_MAX, cut

LINES_PER_S = 100
"""Lines of one plugin that are accepted in a second (chosen)."""
SECOND_NS = to_ns(1.0)
PAUSE_S = 0.0002
"""Pause of a thread for each line that is dropped, so that it does not keep Python's lock from the other plugins."""

WriteLine = Callable[[str, str, str], None]
"""Gets the plugin, the level and the line."""


class _Second(msgspec.Struct):
    begin_ns: int
    accepted: int = 0
    dropped: int = 0


class PluginOutput:
    """Accepts the lines of plugins, on any thread, and drops those above the limit.

    Args:
        write: called with each accepted line, and with a warning that counts dropped lines.
        plugin_here: name of the plugin whose code runs on the calling thread; empty if none.
        clock: measures the seconds.

    """

    def __init__(self, write: WriteLine, plugin_here: Callable[[], str], clock: Clock) -> None:
        self.write = write
        self.plugin_here = plugin_here
        self._clock = clock
        self._seconds: dict[str, _Second] = {}

    def accept(self, plugin: str, level: str, line: str) -> bool:
        """Accept a line, or count it as dropped; returns whether it is accepted."""
        now_ns = self._clock.now_ns()
        second = self._seconds.setdefault(plugin, _Second(now_ns))
        if now_ns - second.begin_ns >= SECOND_NS:
            self._report(plugin, second)
            second.begin_ns, second.accepted = now_ns, 0
        if second.accepted >= LINES_PER_S:
            second.dropped += 1
            time.sleep(PAUSE_S)
            return False
        second.accepted += 1
        self.write(plugin, level, cut(line.encode(errors="replace").decode(), TEXT_MAX))
        return True

    def report_dropped(self) -> None:
        """Report the lines that were dropped in seconds that have passed; to be called about once a second."""
        now_ns = self._clock.now_ns()
        for plugin, second in list(self._seconds.items()):
            if second.dropped and now_ns - second.begin_ns >= SECOND_NS:
                self._report(plugin, second)

    def _report(self, plugin: str, second: _Second) -> None:
        dropped, second.dropped = second.dropped, 0
        if dropped:
            self.write(plugin, "warning", f"{dropped} lines dropped: more than {LINES_PER_S} in a second")


class PluginStream:
    """Stands for a standard stream: the lines of plugins are accepted by a `PluginOutput` before they are written.

    Args:
        stream: the stream itself.
        output: accepts the lines.

    """

    def __init__(self, stream: TextIO, output: PluginOutput) -> None:
        self._stream, self._output = stream, output
        self._begun: dict[str, str] = {}
        """By plugin, the line that it has not ended."""

    def write(self, text: str) -> int:
        """Write text; a plugin's appears when its line ends."""
        plugin = self._output.plugin_here()
        if not plugin:
            return self._stream.write(text)
        *lines, begun = (self._begun.pop(plugin, "") + text).split("\n")
        self._begun[plugin] = begun[-TEXT_MAX:]
        for line in lines:
            if self._output.accept(plugin, "info", line):
                self._stream.write(f"{line}\n")
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class PluginLogs(logging.Handler):
    """Passes on the log records of plugins.

    Args:
        output: accepts them.

    """

    def __init__(self, output: PluginOutput) -> None:
        super().__init__(logging.INFO)
        self._output = output

    def emit(self, record: logging.LogRecord) -> None:
        """Pass on a record; one with an attribute `plugin` was accepted in that plugin's process."""
        level, text = record.levelname.lower(), self.format(record)
        if (plugin := getattr(record, "plugin", "")) != "":
            self._output.write(plugin, level, text)
        elif (plugin := self._output.plugin_here()) != "":
            self._output.accept(plugin, level, text)
