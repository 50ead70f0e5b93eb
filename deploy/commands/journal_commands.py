"""`robrain journal`: back up a coordinator's journal while it runs, check and restore it."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robrain.deploy.command_line.command_group import OPERATE, CommandApp
from robrain.deploy.command_line.options import ConnectOption, JsonOption, TeamOption
from robrain.deploy.command_line.output import print_either
from robrain.deploy.errors import UsageError
from robrain.protocol.keys import DEFAULT_TEAM, check_name

if TYPE_CHECKING:
    from robrain.coordinator.journal.backup import JournalContents

EXIT_PROBLEMS = 1
"""A journal or backup that was checked has problems."""

journal_app = CommandApp(OPERATE, "journal", "Back up, check and restore a coordinator's journal.")


@journal_app.command()
def backup(
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    journal: Annotated[
        Path | None, typer.Option(help="Back up this file, which no coordinator has open, instead of asking one.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="With --journal: file to write; it must not exist.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Have the coordinator back up its journal, on its own machine, into FILE.backups; the newest 14 are kept."""
    if (journal is None) != (output is None):
        raise UsageError("--journal and --output: give both, or neither")
    if journal is not None and output is not None:
        from robrain.coordinator.journal.backup import back_up_closed

        found = back_up_closed(journal, output)
        print_either(found, [f"{output}: {_words(found)}"], as_json=as_json)
        return
    from robrain.deploy.processes.live_process import client_endpoint
    from robrain.protocol.errors import NobodyThere
    from robrain.protocol.messages.team.standing_messages import COORDINATOR_BACKUP
    from robrain.protocol.safe_text import safe_text
    from robrain.protocol.wire.hub import wrong_team

    check_name("team", team)
    with client_endpoint(connect, team) as wire:
        try:
            made = wire.ask(COORDINATOR_BACKUP)
        except NobodyThere as error:
            raise wrong_team(f"no coordinator of team {team} answers", wire) from error
    text = f"{made.path} on {made.host}: {made.tasks} tasks, {made.open} of them open, {made.bytes / 1e6:.2f} MB"
    print_either(made, [safe_text(text)], as_json=as_json)


@journal_app.command()
def restore(
    backup: Annotated[Path, typer.Argument(help="A backup.")],
    journal: Annotated[Path, typer.Option(help="The journal whose content is replaced; made if there is none.")],
    as_json: JsonOption = False,
) -> None:
    """Restore a journal from a backup; refused while a coordinator has it open."""
    from robrain.coordinator.journal.backup import restore_backup

    done = restore_backup(backup, journal)
    print_either(done, [*done.report, f"{journal}: {_words(done.contents)}"], as_json=as_json)


@journal_app.command()
def check(
    journal: Annotated[Path, typer.Argument(help="A backup, or a journal that no coordinator has open.")],
    as_json: JsonOption = False,
) -> None:
    """Check a journal or a backup. Exit status 1 if it has problems."""
    from robrain.coordinator.journal.backup import check_journal

    found = check_journal(journal)
    print_either(found, [f"{journal}: {_words(found)}", *found.problems], as_json=as_json)
    if found.problems:
        raise typer.Exit(EXIT_PROBLEMS)


def _words(found: "JournalContents") -> str:
    last = datetime.fromtimestamp(found.last_changed_ns / 1e9, UTC).isoformat(sep=" ", timespec="seconds")
    text = f"{found.tasks} tasks, {found.open} of them open, {found.bytes / 1e6:.2f} MB"
    return f"{text}, last changed {last}" if found.last_changed_ns else text
