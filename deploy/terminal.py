"""Lines for a person: what a command was asked for goes to stdout, progress, hints and warnings to stderr."""

import sys

from rich.console import Console
from rich.markup import escape

from robrain.deploy.live_process import tell
from robrain.protocol.wire.safe_text import safe_text

PLAIN_WIDTH = 200
"""Columns of a table that goes into a file or a pipe."""

console = Console(stderr=True, highlight=False)
"""For progress and hints."""


def say(text: str) -> None:
    """A line on stderr; text from elsewhere is shown as it is, without markup, and cannot steer the terminal."""
    console.print(escape("\n".join(map(safe_text, text.split("\n")))), soft_wrap=True)


def print_line(text: str) -> None:
    """A line of what the command was asked for, on stdout, at once; made safe as by `say`."""
    tell("\n".join(map(safe_text, text.split("\n"))))


def results() -> Console:
    """For tables of what the command was asked for, on stdout."""
    found = Console(highlight=False)
    return found if found.is_terminal else Console(highlight=False, width=PLAIN_WIDTH)


def both_at_a_terminal() -> bool:
    """Whether stdout may be drawn together with the progress on stderr; else it goes its own way, to a pipe maybe."""
    return sys.stdout.isatty()


def clock_of(seconds: float) -> str:
    """Minutes and seconds.

    >>> clock_of(83.9)
    '01:23'
    """
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes:02d}:{rest:02d}"
