"""The `robrain` command: its subcommands by purpose, and mistakes on the command line as one sentence."""

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from robrain.deploy.errors import UsageError
from robrain.protocol.extras import missing_package

GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "Simulate": ("demo", "run", "scenarios", "sweep", "soak", "fork", "bench"),
        "Start a team": ("up", "hub", "router", "coordinator", "agent", "arena", "dashboard"),
        "Operate a team": (
            *("status", "top", "task", "halt", "resume", "call", "log", "shell", "plugin"),
            *("lead", "remove", "journal", "assistant"),
        ),
        "Record and look back": (
            *("record", "replay", "info", "check", "diff", "recover", "report", "export", "foxglove"),
        ),
        "Set up": ("doctor", "bringup", "pki", "machine-files"),
        "Connect other programs": ("ros2", "metrics", "wire"),
    }
)
"""Headings of `robrain --help`, with the commands below them."""


class CommandGroup(TyperGroup):
    """Lists its commands under headings; prints a mistake as all other errors are printed."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a list of commands for each heading."""
        longest = max(map(len, self.commands))
        for heading, names in GROUPS.items():
            with formatter.section(heading):
                width = formatter.width - 6 - longest
                shown = [(name.ljust(longest), self.commands[name].get_short_help_str(width)) for name in names]
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


OF_COMMANDS = {
    **dict.fromkeys(("run", "demo", "up", "arena", "scenarios", "bench", "soak"), "sim"),
    **dict.fromkeys(("dashboard", "replay", "record", "info", "check", "diff", "recover", "export"), "team"),
    "bringup": "bringup",
    "report": "report",
    "sweep": "sweep",
    "fork": "sim,team",
    "foxglove": "foxglove",
    "assistant": "mcp",
    "ros2": "team,ros2-native,ros2",
    "bench allocation": "team",
    "bench consensus": "team",
    "bench log": "navigation",
}
"""Extra with all that a command needs, navigation included."""


def missing_extra(error: ModuleNotFoundError, words: Sequence[str]) -> UsageError | None:
    """An error that says what to install after a failed import; None if no extra contains the package.

    A command that lacks arrays mostly lacks more, and names the extra that has everything.

    Args:
        error: of the import.
        words: the command line.

    >>> str(missing_extra(ModuleNotFoundError("No module named 'mcap.writer'", name="mcap.writer"), ["record"]))
    "mcap is not installed: pip install 'robrain[team]'"
    >>> str(missing_extra(ModuleNotFoundError("No module named 'numpy'", name="numpy"), ["run", "depot"]))
    "numpy is not installed: pip install 'robrain[sim]'"
    """
    missing = missing_package(error)
    if missing is None or not missing.extra:
        return None
    if missing.extra in ("navigation", "team") and words:
        known = OF_COMMANDS.get(" ".join(words[:2])) or OF_COMMANDS.get(words[0], missing.extra)
        missing = missing._replace(extra=known)
    return UsageError(f"{missing.package} is not installed: pip install '{missing.needed}'")
