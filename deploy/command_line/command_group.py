"""The `robrain` command: its subcommands by purpose, and mistakes on the command line as one sentence."""

import inspect
import logging
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from robrain.deploy.command_line.options import ConnectOption, JsonOption, TeamOption, connect_team
from robrain.deploy.command_line.output import print_either
from robrain.deploy.errors import UsageError
from robrain.protocol.extras import missing_package
from robrain.protocol.keys import DEFAULT_TEAM

if TYPE_CHECKING:
    from robrain.client.team import Team

ENTRY_POINTS = "robrain.commands"
"""Group of entry points: each names a `typer.Typer`. The extra with all that its commands need is in brackets."""
SIMULATE, START, OPERATE = "Simulate", "Start a team", "Operate a team"
RECORDINGS, SET_UP, CONNECT = "Record and look back", "Set up", "Connect other programs"
HEADINGS = (SIMULATE, START, OPERATE, RECORDINGS, SET_UP, CONNECT)
"""Of `robrain --help`: a command is below its `rich_help_panel`, or that of its app, and else at the end."""
OTHERS = "Other commands"
ConnectTeam = Callable[[], "Team"]
"""Connects to the team that the command names; the command ends the connection."""
Shown = tuple[object, Iterable[str]] | None
"""Output of a command: a value for `--json`, and the same as lines. None if the command prints by itself."""

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


class CommandApp(typer.Typer):
    """Commands below a heading.

    Args:
        heading: of `robrain --help`.
        name: the word before them; None if they have none.
        text: help of the name.

    """

    def __init__(self, heading: str, name: str | None = None, text: str | None = None) -> None:
        super().__init__(
            name=name, help=text, rich_help_panel=heading, no_args_is_help=name is not None, rich_markup_mode=None
        )

    def team_command(self, *names: str) -> Callable[[Callable[..., Shown]], Callable[..., None]]:
        """Add a command that asks a team; `--connect` and `--team` are added to its options.

        A function with a result has `--json` as well: its result is printed. It checks its own options, and then calls
        its first argument, which connects it to the team.

        Args:
            names: of the command; default: that of the function.

        """

        def add(function: Callable[..., Shown]) -> Callable[..., None]:
            signature = inspect.signature(function)
            has_result = function.__annotations__["return"] is not None
            added = [_option("connect", ConnectOption, None), _option("team", TeamOption, DEFAULT_TEAM)]
            added += [_option("as_json", JsonOption, False)] if has_result else []

            def command(*, connect: str | None, team: str, **options: Any) -> None:
                as_json = has_result and options.pop("as_json")
                with ExitStack() as stack:
                    shown = function(lambda: stack.enter_context(connect_team(connect, team)), **options)
                if shown is not None:
                    print_either(*shown, as_json=as_json)

            command.__name__, command.__doc__ = function.__name__, function.__doc__
            own = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in signature.parameters.values()]
            command.__signature__ = inspect.Signature(own[1:] + added)  # type: ignore[attr-defined] # which typer reads
            for name in names or (None,):
                self.command(name)(command)
            return command

        return add


def _option(name: str, form: Any, default: object) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=form)


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
