"""What commands print: a run's result, names as they are, and reasons of several lines."""

import logging
import re
import shlex
import sys

import pytest
from rich.console import Group
from rich.table import Table

from robrain import cli
from robrain.client.team import Team
from robrain.deploy.command_line.output import print_message, print_result
from robrain.deploy.command_line.terminal import results
from robrain.deploy.processes.process_setup import SafeLines
from robrain.deploy.processes.run_display import print_recorded
from robrain.protocol.errors import CallError, ErrorCode
from robrain.testing import PluginBench
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


REASON = "bad input:\r\n\x1b[31mr1: up\n\tat 3"
SHOWN = "bad input:\n  \\x1b[31mr1: up\n      at 3\n"


def log(text: str) -> None:
    record = logging.LogRecord("robrain", logging.ERROR, "", 0, "%s", (text,), None)
    sys.stdout.write(SafeLines("%(message)s").format(record) + "\n")


@pytest.mark.parametrize("show", [print_result, print_message, log])
def test_lines_after_the_first_are_indented_and_steer_nothing(capsys: pytest.CaptureFixture[str], show) -> None:
    show(REASON)
    assert "".join(capsys.readouterr()) == SHOWN


def test_refused_command_prints_the_lines_of_its_reason(capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    def refuse(*_words: object, **_options: object) -> Team:
        raise CallError(ErrorCode.REFUSED, REASON, detail="Traceback\n  File")

    monkeypatch.setattr(Team, "connect", refuse)
    monkeypatch.setattr(cli, "set_up_logs", lambda words: words)  # leaves the logs of the tests alone
    monkeypatch.setattr("sys.argv", ["robrain", "plugin", "list", "r1"])
    with pytest.raises(SystemExit):
        cli.main()
    assert capsys.readouterr().err == f"robrain: {SHOWN}  Traceback\n    File\n"


class _Client:
    def __init__(self, bench: PluginBench) -> None:
        self._bench = bench

    def __enter__(self) -> "_Client":
        return self

    def __exit__(self, *_: object) -> None: ...

    def plugins(self, _robot: str) -> list[object]:
        return [self._bench.info("bad")]
