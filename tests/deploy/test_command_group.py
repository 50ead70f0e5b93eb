"""`robrain --help` lists every command under a heading, and mistakes are one sentence, as all other errors."""

import logging
from importlib.metadata import EntryPoint

import pytest
import typer
from typer.main import get_command

from robrain.cli import all_commands
from robrain.deploy.command_line import command_group
from robrain.deploy.command_line.command_group import ENTRY_POINTS, HEADINGS, CommandGroup, add_registered


def test_every_command_is_under_one_heading() -> None:
    group = get_command(all_commands())
    assert isinstance(group, CommandGroup)
    assert len(group.commands) > 40
    assert {
        name: one.rich_help_panel for name, one in group.commands.items() if one.rich_help_panel not in HEADINGS
    } == {}


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("statsu", "robrain: no such command 'statsu'. Did you mean 'status', 'task'?"),
        ("status --foo", "robrain: no such option: --foo; see robrain status --help"),
        ("call r1", "robrain: missing argument 'plugin'; see robrain call --help"),
        ("task foo", "robrain: no such command 'foo'; see robrain task --help"),
        ("run --robots x", "robrain: invalid value for '--robots': "),
    ],
)
def test_mistake_on_the_command_line_is_one_sentence(capsys: pytest.CaptureFixture[str], words: str, says: str) -> None:
    with pytest.raises(SystemExit) as ended:
        all_commands()(words.split(), prog_name="robrain")
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(says)
    assert ended.value.code == 2


@pytest.mark.parametrize(("words", "status"), [("--version", 0), ("--help", 0), ("", 2), ("task", 2)])
def test_help_goes_to_stdout(capsys: pytest.CaptureFixture[str], words: str, status: int) -> None:
    with pytest.raises(SystemExit) as ended:
        all_commands()(words.split(), prog_name="robrain")
    assert ended.value.code == status
    assert "robrain" in capsys.readouterr().out


extra = typer.Typer()


@extra.command()
def greet_all() -> None:
    """Greet."""


def test_commands_of_other_packages_are_added_and_those_that_cannot_be_loaded_are_reported(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    values = {"mine": f"{__name__}:extra [sim,team]", "gone": "no_such_module:app", "wrong": "logging:INFO"}
    found = [EntryPoint(name, value, ENTRY_POINTS) for name, value in values.items()]
    monkeypatch.setattr(command_group, "entry_points", lambda group: found)
    app = typer.Typer(cls=CommandGroup)
    assert add_registered(app) == {"greet-all": "sim,team"}
    app.command("other")(lambda: None)
    assert "greet-all" in get_command(app).commands
    assert ["no_such_module:app" in caplog.text, "logging:INFO" in caplog.text] == [True, True]
