"""Log records of a process as text or as JSON lines: the one place where logging is set up.

A line has the time, the level, the logger and the message, and, as far as they are known, the robot, the plugin and
the task that the thread was at. `--log-format json` before the command, or `ROBRAIN_LOG_FORMAT=json`, chooses it.
"""

import logging
import os
from collections.abc import Callable
from datetime import UTC, datetime
from typing import NoReturn

import msgspec

from robrain.deploy.errors import UsageError
from robrain.protocol.safe_text import safe_json, safe_lines

FORMAT_VARIABLE = "ROBRAIN_LOG_FORMAT"
OPTION = "--log-format"
FORMATS = ("text", "json")
TEXT = "%(levelname)s %(name)s: %(message)s"


class LogContext:
    """What a process's records are about."""

    def __init__(self) -> None:
        self.robot = ""
        """Name of the robot whose process it is; empty for other processes."""
        self.plugin: Callable[[], str] = str
        """Name of the plugin whose code runs on the calling thread; empty if none."""
        self.task: Callable[[], tuple[str, str]] = lambda: ("", "")
        """Id and trace of the task that the robot is at; both empty if none."""


CONTEXT = LogContext()
"""The context of this process."""


class JsonLines(logging.Formatter):
    """Formats each record as one JSON object on one line.

    Args:
        context: of the process.

    """

    def __init__(self, context: LogContext) -> None:
        super().__init__()
        self._context = context

    def format(self, record: logging.LogRecord) -> str:
        """The line, without a line break."""
        task, trace = self._context.task()
        fields: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            "robot": self._context.robot,
            "plugin": getattr(record, "plugin", "") or self._context.plugin(),
            "task": task,
            "trace": trace,
            "process": record.process,
        }
        if record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        return safe_json(msgspec.json.encode({name: value for name, value in fields.items() if value != ""}))


class SafeLines(logging.Formatter):
    """Formats a record for a terminal, with indented lines after the first: a message cannot pass for two."""

    def format(self, record: logging.LogRecord) -> str:
        """The line and the traceback."""
        return safe_lines(super().format(record), "  ")


def set_up_logs(words: list[str]) -> list[str]:
    """Set up the logs of this process by `--log-format` before a command, or the environment.

    Args:
        words: the command line, without the program's name.

    Returns:
        The words without the option.

    Raises:
        UsageError: there is no such format.

    """
    chosen, rest = os.environ.get(FORMAT_VARIABLE, "") or "text", words
    if words[:1] == [OPTION]:
        chosen, rest = (words[1] if len(words) > 1 else ""), words[2:]
    elif words and words[0].startswith(f"{OPTION}="):
        chosen, rest = words[0].partition("=")[2], words[1:]
    if chosen not in FORMATS:
        _complain(chosen)
    os.environ[FORMAT_VARIABLE] = chosen  # processes that this one starts do the same
    handler = logging.StreamHandler()
    handler.setFormatter(JsonLines(CONTEXT) if chosen == "json" else SafeLines(TEXT))
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns of a cache that it cannot write, and works
    return rest


def _complain(chosen: str) -> NoReturn:
    raise UsageError(f"{OPTION} {chosen}: expected {' or '.join(FORMATS)}")
