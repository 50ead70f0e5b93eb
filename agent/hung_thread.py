"""A thread that does not come back from a plugin: the line that it is at, and its end."""

import ctypes
import sys
from types import TracebackType

from robrain.agent.plugin import Plugin
from robrain.agent.plugin_traceback import is_of_host


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
