"""`robrain rule`: show and change the rules and schedules of a running team."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from robrain.deploy.command_line.command_group import OPERATE, CommandApp, ConnectTeam, Shown
from robrain.deploy.errors import UsageError
from robrain.protocol.clock import to_seconds
from robrain.protocol.messages.tasks.rule_messages import RuleStatus, RuleTable
from robrain.protocol.model.rules.rule import Rule

rule_app = CommandApp(OPERATE, "rule", "Show and change rules and schedules, which create tasks.")


class ChangedRules(msgspec.Struct, frozen=True):
    """The tables read here; their missions may be those that the team has."""

    rules: tuple[Rule, ...] = ()


@rule_app.team_command("list")
def list_rules(connect: ConnectTeam) -> Shown:
    """List the team's rules and their states."""
    return _shown(connect().rules())


@rule_app.team_command()
def put(connect: ConnectTeam, file: Annotated[Path, typer.Argument(help="TOML file with [[rules]].")]) -> Shown:
    """Add the rules of a file; they replace rules with the same names. All others keep their states."""
    from robrain.deploy.processes.table_files import tables_in

    rules = tables_in(file, ChangedRules, "FILE").rules
    if not rules:
        raise UsageError(f"FILE {file}: expected at least one table [[rules]]")
    return _shown(connect().change_rules(*rules))


@rule_app.team_command()
def remove(
    connect: ConnectTeam, names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of rules.")]
) -> Shown:
    """Remove rules."""
    return _shown(connect().change_rules(remove=names))


def _shown(table: RuleTable) -> Shown:
    return table, map(_text_of, table.states) if table.states else ["the team has no rules"]


def _text_of(one: RuleStatus) -> str:
    due = f", due {datetime.fromtimestamp(to_seconds(one.next_ns), UTC):%Y-%m-%d %H:%M:%S} UTC" if one.next_ns else ""
    refused = f", {one.refused} refused: {one.why}" if one.refused else ""
    return f"{one.name}: {one.waits}; {one.made} made, {one.open} open{due}{refused}"
