"""What the terminal library could read as markup or emoji is printed as it is."""

import re
import shlex

import pytest
from rich.console import Group
from rich.progress import Progress
from rich.table import Table

from robrain.deploy.command_line.terminal import new_console, results, say, text_column
from robrain.deploy.processes.run_display import print_recorded
from tests.product import FOLDERS, ROOT

NAME = "rec:bus:[1][red]x[/].mcap"


def table() -> Table:
    found = Table(NAME, title=NAME)
    found.add_row(NAME)
    return found


@pytest.mark.parametrize("shown", [NAME, Group(NAME), table()])
def test_names_are_printed_literally(capsys: pytest.CaptureFixture[str], shown: object) -> None:
    results().print(shown)
    assert capsys.readouterr().out.count(NAME) == (3 if isinstance(shown, Table) else 1)


def test_messages_and_progress_are_printed_literally(capsys: pytest.CaptureFixture[str]) -> None:
    say(NAME)
    with Progress(text_column("{task.description}"), console=new_console(stderr=True)) as bars:
        bars.add_task(NAME)
    assert capsys.readouterr().err.count(NAME) == 2


def test_a_proposed_command_can_be_copied_into_a_shell(capsys: pytest.CaptureFixture[str]) -> None:
    print_recorded(f"run #3 {NAME}")
    assert shlex.split(capsys.readouterr().err)[-2:] == ["replay", f"run #3 {NAME}"]


def test_there_is_no_other_console() -> None:
    other = re.compile(r"\b(Console|TextColumn|from_markup)\(|from rich import|rich\.(print|markup)")
    lines = [
        f"{path.relative_to(ROOT)}: {line}"
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if other.search(line)
    ]
    assert [line.partition(":")[0] for line in lines] == ["deploy/command_line/terminal.py"] * 2, lines
