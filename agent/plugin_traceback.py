"""Errors in plugin code, for its author: the line that raised, and the traceback from the plugin's first frame.

The host's frames above the plugin are omitted. Files are shown by name and folder only, since callers outside see the
text too. For a thread that hangs in a plugin: the line that it is at, and its end.
"""

import ctypes
import importlib.util
import logging
import sys
import sysconfig
import traceback
from collections.abc import Iterator
from functools import cache
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, TypeVar

from robrain.agent.errors import PackageMissing, short_path
from robrain.agent.plugin import Plugin

MOST_CHARACTERS = 4000
MOST_FRAMES = 20
MOST_CAUSES = 10
_ELSEWHERE = "_robrain_raised"
"""Attribute of an error that was raised in another process: its `Raised`."""

ErrorT = TypeVar("ErrorT", bound=BaseException)


class Raised(NamedTuple):
    """Where a plugin's code raised an error; both empty if no plugin code was involved."""

    where: str = ""
    """The line, such as `lamp/lamp.py:12 in step`."""
    detail: str = ""
    """The traceback, from the plugin's first frame."""

    def after(self, reason: str) -> str:
        """`why`, followed by the line in brackets if there is one."""
        return f"{reason} ({self.where})" if self.where else reason


def raised(error: BaseException | None) -> Raised:
    """The line and traceback of an error.

    Empty if `error` is None, if no plugin code was involved, or if it only lacks a package: its author is not to blame.
    """
    if error is None or isinstance(error, PackageMissing):
        return Raised()
    for cause in causes_of(error):
        elsewhere: Raised | None = getattr(cause, _ELSEWHERE, None)
        if elsewhere is not None:
            return elsewhere
        frames, source = _frames(cause), _not_python(cause)
        if frames or source:
            return Raised(_where(cause, frames, source), _detail(cause, frames, source))
    return Raised()


def raised_elsewhere(error: ErrorT, where: Raised) -> ErrorT:
    """The error, with the line and traceback of another process that it comes from."""
    vars(error)[_ELSEWHERE] = where
    return error


def log_error(logger: logging.Logger, what: str, error: BaseException) -> str:
    """Log a failure at level error, with its traceback in plugin code; returns that traceback."""
    detail = raised(error).detail
    logger.error("%s: %s%s", what, error, f"\n{detail}" if detail else "")
    return detail


def _where(cause: BaseException, frames: list[traceback.FrameSummary], source: str) -> str:
    """The innermost line in the plugin's own folder, such as `lamp/lamp.py:12 in step`."""
    if source:
        return f"{short_path(Path(source))}:{getattr(cause, 'lineno', 0)}"
    folder = Path(frames[0].filename).parent
    last = [frame for frame in frames if Path(frame.filename).parent == folder][-1]
    return f"{short_path(Path(last.filename))}:{last.lineno} in {last.name}"


def _detail(cause: BaseException, frames: list[traceback.FrameSummary], source: str) -> str:
    """The traceback from the plugin's first frame, at most `MOST_CHARACTERS`."""
    lines = ["Traceback (most recent call last):\n"] if frames else []
    if len(frames) > MOST_FRAMES:
        half = MOST_FRAMES // 2
        lines += _format(frames[:half])
        lines.append(f"  … {len(frames) - 2 * half} more …\n")
        frames = frames[-half:]
    lines += _format(frames)
    last = "".join(traceback.format_exception_only(cause))
    if source:
        last = last.replace(source, short_path(Path(source)))
    text = "".join([*lines, last]).rstrip()
    return text if len(text) <= MOST_CHARACTERS else f"…{text[1 - MOST_CHARACTERS :]}"


def causes_of(error: BaseException) -> Iterator[BaseException]:
    """An error and its causes, outermost first; at most `MOST_CAUSES`."""

    def walk() -> Iterator[BaseException]:
        cause: BaseException | None = error
        while cause is not None:
            yield cause
            cause = cause.__cause__ or (None if cause.__suppress_context__ else cause.__context__)

    return islice(walk(), MOST_CAUSES)


def _not_python(error: BaseException) -> str:
    """The plugin's file with the syntax error, if the error is one; else empty."""
    file = error.filename if isinstance(error, SyntaxError) else None
    return file if file and not is_of_host(file) else ""


def _frames(error: BaseException) -> list[traceback.FrameSummary]:
    """The frames from the plugin's first one; empty if no plugin code is in the traceback."""
    frames = list(traceback.extract_tb(error.__traceback__))
    for index, frame in enumerate(frames):
        if not is_of_host(frame.filename):
            return frames[index:]
    return []


def _format(frames: list[traceback.FrameSummary]) -> list[str]:
    lines = []
    for frame in frames:
        lines.append(f'  File "{short_path(Path(frame.filename))}", line {frame.lineno}, in {frame.name}\n')
        if frame.line:
            lines.append(f"    {frame.line}\n")
    return lines


def is_of_host(file: str) -> bool:
    """Whether a file belongs to the host or to Python itself, not to a plugin."""
    if file.startswith(("<", *_host_folders())):
        return True
    library = f"{sysconfig.get_paths()['stdlib']}/"
    return file.startswith(library) and not file.startswith((f"{library}site-packages/", f"{library}dist-packages/"))


@cache
def _host_folders() -> tuple[str, ...]:
    folders = []
    for package in ("agent", "algorithms", "protocol", "deploy", "coordinator", "sim"):
        spec = importlib.util.find_spec(f"robrain.{package}")
        for place in (spec.submodule_search_locations or ()) if spec is not None else ():
            folders += [f"{place}/", f"{Path(place).resolve()}/"]
    return tuple(folders)


class ThreadEnded(SystemExit):
    """Raised in a thread that is in an abandoned plugin. Not an Exception, which the plugin may catch."""


def traceback_in(thread: int, plugin_class: type[Plugin] | None) -> TracebackType | None:
    """Where a thread is in a plugin, from the plugin's first line on; None if it is not in it.

    The line of an instruction that the compiler has added, which has none, is the first of its function.

    Args:
        thread: its identifier.
        plugin_class: the plugin's class; None for the innermost code that is not of the host.

    """
    frame, found, inside = sys._current_frames().get(thread), None, None
    while frame is not None:
        found = TracebackType(found, frame, frame.f_lasti, frame.f_lineno or frame.f_code.co_firstlineno)
        if plugin_class is None:
            if not is_of_host(frame.f_code.co_filename):
                inside = found
            elif inside is not None:
                break
        elif frame.f_globals.get("__name__") == plugin_class.__module__:
            inside = found
        frame = frame.f_back
    return inside


def end_thread(thread: int) -> None:
    """Raise ThreadEnded in a thread. It has no effect before the thread executes Python code again."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(ThreadEnded))
