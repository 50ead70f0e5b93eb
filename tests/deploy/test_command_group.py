"""`robrain --help` lists every command under a heading, and mistakes are one sentence, as all other errors."""

import pytest
from typer.main import get_command

from robrain.cli import app
from robrain.deploy.command_line.command_group import GROUPS, CommandGroup


def test_every_command_is_under_one_heading() -> None:
    group = get_command(app)
    assert isinstance(group, CommandGroup)
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(group.commands)


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
        app(words.split(), prog_name="robrain")
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(says)
    assert ended.value.code == 2


@pytest.mark.parametrize(("words", "status"), [("--version", 0), ("--help", 0), ("", 2), ("task", 2)])
def test_help_goes_to_stdout(capsys: pytest.CaptureFixture[str], words: str, status: int) -> None:
    with pytest.raises(SystemExit) as ended:
        app(words.split(), prog_name="robrain")
    assert ended.value.code == status
    assert "robrain" in capsys.readouterr().out
