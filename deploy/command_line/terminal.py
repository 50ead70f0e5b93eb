"""Terminal output: results go to stdout; progress, hints and warnings to stderr."""

import os
import shlex
import shutil
import sys
from collections.abc import Collection
from pathlib import Path

from rich.console import Console
from rich.progress import TextColumn
from rich.table import Table

from robrain.deploy.command_line.output import print_result
from robrain.protocol.safe_text import safe_lines

PLAIN_WIDTH = 200
"""Width of a table written to a file or pipe, in columns."""


def new_console(*, stderr: bool = False, width: int | None = None) -> Console:
    """A console that prints strings literally: a name such as `bus:bus:[1]` has no markup. Styled text is a `Text`."""
    return Console(stderr=stderr, width=width, highlight=False, markup=False, emoji=False)


def text_column(text_format: str, style: str = "none") -> TextColumn:
    """A column of a progress line that prints its fields literally."""
    return TextColumn(text_format, style=style, markup=False)


console = new_console(stderr=True)
"""Console for progress and hints, on stderr."""
NAME = "robrain"


def print_progress(text: str) -> None:
    """Print a line on stderr; control characters in it are made harmless."""
    console.print(safe_lines(text), soft_wrap=True)


def print_line(text: str) -> None:
    """Print a line of the result on stdout, unbuffered; made safe as by `say`."""
    for line in text.split("\n"):
        print_result(line)


def results() -> Console:
    """Console for result tables, on stdout."""
    found = new_console()
    return found if found.is_terminal else new_console(width=PLAIN_WIDTH)


def new_table(*headings: str, right: Collection[str] = (), title: str | None = None) -> Table:
    """A table without rules; the columns that are numbers are at the right, and never broken."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in headings:
        is_number = heading in right
        table.add_column(heading, justify="right" if is_number else "left", no_wrap=is_number, overflow="fold")
    return table


def both_at_a_terminal() -> bool:
    """Whether stdout, like stderr, goes to a terminal rather than to a pipe or file."""
    return sys.stdout.isatty()


def clock_of(seconds: float) -> str:
    """Minutes and seconds.

    >>> clock_of(83.9)
    '01:23'
    """
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes:02d}:{rest:02d}"


def own_command(*words: str | Path) -> str:
    """A command of this installation of robrain, to be copied into a shell in the current folder."""
    return f"{_own_program()} {shlex.join(map(str, words))}"


def _own_program() -> str:
    # If the shell's path finds another installation: the script beside this Python, or Python with the module.
    script = Path(sys.executable).with_name(NAME)
    found = shutil.which(NAME)
    if found is not None and (not script.exists() or os.path.samefile(found, script)):
        return NAME
    if not os.access(script, os.X_OK):
        return f"{shlex.quote(sys.executable)} -m {NAME}.cli"
    try:
        return shlex.quote(str(script.relative_to(Path.cwd())))
    except (ValueError, OSError):  # not below this folder, or this folder is gone
        return shlex.quote(str(script))
