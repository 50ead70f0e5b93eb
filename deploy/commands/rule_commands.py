"""`robrain rule`: show and change the rules and schedules of a running team."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from robrain.deploy.command_line.command_group import OPERATE
from robrain.deploy.command_line.options import ConnectOption, JsonOption, TeamOption, connect_team
from robrain.deploy.command_line.output import print_either
from robrain.deploy.errors import UsageError
from robrain.protocol.clock import to_seconds
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.tasks.rule_messages import RuleStatus, RuleTable
from robrain.protocol.model.rules.rule import Rule

rule_app = typer.Typer(
    rich_help_panel=OPERATE,
    name="rule",
    help="Show and change rules and schedules, which create tasks.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


class ChangedRules(msgspec.Struct, frozen=True):
    """The tables read here; their missions may be those that the team has."""

    rules: tuple[Rule, ...] = ()


@rule_app.command("list")
def list_rules(connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM, as_json: JsonOption = False) -> None:
    """List the team's rules and their states."""
    with connect_team(connect, team) as client:
        _print(client.rules(), as_json=as_json)


@rule_app.command()
def put(
    file: Annotated[Path, typer.Argument(help="TOML file with [[rules]].")],
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Add the rules of a file; they replace rules with the same names. All others keep their states."""
    from robrain.deploy.processes.table_files import read_tables

    rules = read_tables(file, ChangedRules, "FILE").rules
    if not rules:
        raise UsageError(f"FILE {file}: expected at least one table [[rules]]")
    with connect_team(connect, team) as client:
        _print(client.change_rules(*rules), as_json=as_json)


@rule_app.command()
def remove(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of rules.")],
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Remove rules."""
    with connect_team(connect, team) as client:
        _print(client.change_rules(remove=names), as_json=as_json)


def _print(table: RuleTable, *, as_json: bool) -> None:
    print_either(table, map(_text_of, table.states) if table.states else ["the team has no rules"], as_json=as_json)


def _text_of(one: RuleStatus) -> str:
    due = f", due {datetime.fromtimestamp(to_seconds(one.next_ns), UTC):%Y-%m-%d %H:%M:%S} UTC" if one.next_ns else ""
    refused = f", {one.refused} refused: {one.why}" if one.refused else ""
    return f"{one.name}: {one.waits}; {one.made} made, {one.open} open{due}{refused}"
