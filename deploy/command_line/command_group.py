"""The `robrain` command: its subcommands by purpose, and mistakes on the command line as one sentence."""

import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.metadata import entry_points
from typing import Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from robrain.deploy.command_line.command_app import HEADINGS
from robrain.deploy.errors import UsageError
from robrain.protocol.extras import missing_package

ENTRY_POINTS = "robrain.commands"
"""Group of entry points: each names a `typer.Typer`. The extra with all that its commands need is in brackets."""
OTHERS = "Other commands"

logger = logging.getLogger(__name__)


def add_registered(app: typer.Typer) -> dict[str, str]:
    """Add the commands of all entry points; returns the extra that each of them needs, by the command's name."""
    extras: dict[str, str] = {}
    for entry in sorted(entry_points(group=ENTRY_POINTS), key=lambda entry: entry.name):
        try:
            part = entry.load()
            if not isinstance(part, typer.Typer):
                raise TypeError(f"expected a typer.Typer, got {type(part).__name__}")
        except Exception as error:  # noqa: BLE001 - foreign code
            logger.warning("the commands of %s cannot be loaded: %s: %s", entry.value, type(error).__name__, error)
            continue
        names = [part.info.name]
        if not isinstance(part.info.name, str):
            names = [info.name or _name_of(info.callback) for info in part.registered_commands]
        for info in part.registered_commands:
            if not isinstance(info.rich_help_panel, str):
                info.rich_help_panel = part.rich_help_panel
        app.add_typer(part, rich_help_panel=part.rich_help_panel)
        extras |= {str(name): ",".join(entry.extras) for name in names if entry.extras}
    return extras


def _name_of(function: Callable[..., Any] | None) -> str:
    return "" if function is None else function.__name__.replace("_", "-")


class CommandGroup(TyperGroup):
    """Lists its commands under headings; prints a mistake as all other errors are printed."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a list of commands for each heading."""
        longest = max(map(len, self.commands))
        width = formatter.width - 6 - longest
        found: dict[str, list[tuple[str, str]]] = {heading: [] for heading in (*HEADINGS, OTHERS)}
        for name, command in self.commands.items():
            heading = getattr(command, "rich_help_panel", None)
            below = found[heading if heading in found else OTHERS]
            below.append((name.ljust(longest), command.get_short_help_str(width)))
        for heading, shown in found.items():
            if shown:
                with formatter.section(heading):
                    formatter.write_dl(shown)

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run a command, and end the process with its status."""
        run = partial(super().main, standalone_mode=False, **extra)
        if not standalone_mode:
            return run(*args)
        try:
            status = run(*args)
        except TyperException as error:
            context = getattr(error, "ctx", None)
            if context is not None and error.message == context.get_help():  # a group without a command
                sys.stdout.write(f"{error.message}\n")
                sys.exit(error.exit_code)
            text = error.format_message().rstrip(".")
            hint = "" if context is None or text.endswith("?") else f"; see {context.command_path} --help"
            sys.stderr.write(f"robrain: {text[:1].lower()}{text[1:]}{hint}\n")
            sys.exit(error.exit_code)
        except typer.Abort:
            sys.exit(1)
        sys.exit(status or 0)


def missing_extra(error: ModuleNotFoundError, words: Sequence[str], extras: Mapping[str, str]) -> UsageError | None:
    """An error that names the extra to install after a failed import; None if no extra contains the package.

    A command that lacks arrays mostly lacks more, and names the extra that has all packages.

    Args:
        error: of the import.
        words: the command line.
        extras: packages that each command needs.

    >>> missing = ModuleNotFoundError("No module named 'numpy'", name="numpy")
    >>> str(missing_extra(missing, ["run", "depot"], {"run": "sim"}))
    "numpy is not installed: pip install 'robrain[sim]'"
    """
    missing = missing_package(error)
    if missing is None or not missing.extra:
        return None
    if missing.extra in ("navigation", "team") and words:
        missing = missing._replace(extra=extras.get(words[0], missing.extra))
    return UsageError(f"{missing.package} is not installed: pip install '{missing.needed}'")
