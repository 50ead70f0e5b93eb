"""The page of the commands, from the options that they declare."""

from typing import Any

import typer

from robrain.cli import all_commands
from tests.reference_pages.markdown import page, table

INTRODUCTION = """\
Every command prints results on stdout, progress and warnings on stderr. An error is one sentence with exit status 2;
output that cannot be written is one with 1. Ctrl-C ends a command with 130. Commands that serve or record until then
end with 0: `agent`, `coordinator`, `dashboard`, and `record` and `up` without `--until` and `--time-limit`.
In `robrain shell` it clears the line; `exit` or Ctrl-D ends the shell. `robrain COMMAND --help` prints the same as
this page. Other pages: [robrain task](commands-task.md), [robrain mission](commands-mission.md),
[robrain rule](commands-rule.md), [robrain zone](commands-zone.md), [robrain robot](commands-robot.md),
[robrain plugin](commands-plugin.md), [robrain journal](commands-journal.md), [robrain pki](commands-pki.md),
[robrain ros2](commands-ros2.md) and [robrain bench](commands-bench.md). The
[commands for recordings](commands-recordings.md) have a page too.

A distribution adds commands by an entry point of the group `robrain.commands`, which names a `typer.Typer`. An extra in
brackets behind it is named to the user if a package is missing.
"""
RECORDINGS = ("record", "replay", "foxglove", "info", "check", "diff", "recover", "report", "export", "fork")


def commands_page(group: str | None = None) -> str:
    """The page of a group of commands, such as `task`; without one, of all commands that are in no group."""
    program = typer.main.get_command(all_commands())
    commands = program if group is None else program.commands[group]
    name = "robrain" if group is None else f"robrain {group}"
    found = {name: commands} if group is not None else {}
    found |= {
        f"{name} {child}": one
        for child, one in commands.commands.items()
        if not hasattr(one, "commands") and (group is not None or child not in RECORDINGS)
    }
    return page(
        "Commands" if group is None else f"Commands: {name}",
        INTRODUCTION if group is None else "",
        *(_section(*one) for one in found.items()),
    )


def recording_commands_page() -> str:
    """The page of the commands that make and read recordings."""
    commands = typer.main.get_command(all_commands()).commands
    return page("Commands for recordings", "", *(_section(f"robrain {name}", commands[name]) for name in RECORDINGS))


def _section(name: str, command: Any) -> str:
    """One command; its type is click's, or that of the copy of click that typer brings."""
    context = command.make_context(name, [], resilient_parsing=True)
    usage = " ".join([name, *command.collect_usage_pieces(context)])
    records = [one.get_help_record(context) for one in command.params]
    rows = [(f"`{' '.join(option.split())}`", meaning) for option, meaning in filter(None, records)]
    arguments = table(("option", "meaning"), rows) if rows else ""
    about = (command.help or "").strip()
    return f"## `{name}` {{#{name.replace(' ', '-')}}}\n\n{about}\n\n```text\n{usage}\n```\n\n{arguments}"
