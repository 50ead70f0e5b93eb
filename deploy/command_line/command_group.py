"""The `robrain` command: its subcommands by purpose, and mistakes on the command line as one sentence."""

import sys
from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

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
