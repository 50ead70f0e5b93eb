"""Terminal output: results go to stdout; progress, hints and warnings to stderr."""

import sys

from rich.console import Console
from rich.markup import escape

from robrain.deploy.processes.live_process import tell
from robrain.protocol.wire.border.safe_text import safe_text

PLAIN_WIDTH = 200
"""Width of a table written to a file or pipe, in columns."""

console = Console(stderr=True, highlight=False)
"""Console for progress and hints, on stderr."""


def say(text: str) -> None:
    """Print a line on stderr; foreign text is shown without markup, and its control characters are made harmless."""
    console.print(escape("\n".join(map(safe_text, text.split("\n")))), soft_wrap=True)


def print_line(text: str) -> None:
    """Print a line of the result on stdout, unbuffered; made safe as by `say`."""
    tell("\n".join(map(safe_text, text.split("\n"))))


def results() -> Console:
    """Console for result tables, on stdout."""
    found = Console(highlight=False)
    return found if found.is_terminal else Console(highlight=False, width=PLAIN_WIDTH)


def both_at_a_terminal() -> bool:
    """Whether stdout shares the terminal with stderr; if not, it may go to a pipe or file."""
    return sys.stdout.isatty()


def clock_of(seconds: float) -> str:
    """Minutes and seconds.

    >>> clock_of(83.9)
    '01:23'
    """
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes:02d}:{rest:02d}"
