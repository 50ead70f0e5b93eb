"""Groups of commands: those below one heading of `robrain --help`, and those that ask a running team."""

import inspect
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import typer

from robrain.deploy.command_line.options import ConnectOption, JsonOption, TeamOption, connect_team
from robrain.deploy.command_line.output import print_either
from robrain.protocol.keys import DEFAULT_TEAM

if TYPE_CHECKING:
    from robrain.client.team import Team

SIMULATE, START, OPERATE = "Simulate", "Start a team", "Operate a team"
RECORDINGS, SET_UP, CONNECT = "Record and look back", "Set up", "Connect other programs"
HEADINGS = (SIMULATE, START, OPERATE, RECORDINGS, SET_UP, CONNECT)
"""Of `robrain --help`: a command is below its `rich_help_panel`, or that of its app, and else at the end."""

ConnectTeam = Callable[[], "Team"]
"""Connects to the team that the command names; the command ends the connection."""
Shown = tuple[object, Iterable[str]] | None
"""What a command prints: a value for `--json`, and the lines that say the same. None if it prints by itself."""


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
