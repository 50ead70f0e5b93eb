"""A reason of several lines, such as an exception's text, is printed as lines by every command."""

import logging
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from robrain import cli
from robrain.client.team import Team
from robrain.deploy.command_line.output import print_note, print_result
from robrain.deploy.processes.process_setup import SafeLines
from robrain.protocol.errors import CallError, ErrorCode
from robrain.testing import PluginBench

REASON = "bad input:\r\n\x1b[31mr1: up\n\tat 3"
SHOWN = "bad input:\n  \\x1b[31mr1: up\n      at 3\n"


def log(text: str) -> None:
    record = logging.LogRecord("robrain", logging.ERROR, "", 0, "%s", (text,), None)
    sys.stdout.write(SafeLines("%(message)s").format(record) + "\n")


@pytest.mark.parametrize("show", [print_result, print_note, log])
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


def test_plugin_list_shows_the_lines_of_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (
        "from robrain import Unit\nclass Bad(Unit):\n    def init(self) -> None:\n        raise ValueError('a\\nb')\n"
    )
    (tmp_path / "bad.py").write_text(text)
    (tmp_path / "bad.toml").write_text('[plugin]\nclass = "bad:Bad"\n')
    with PluginBench(tmp_path) as bench:
        monkeypatch.setattr(Team, "connect", lambda *_, **__: _Client(bench))
        lines = CliRunner().invoke(cli.all_commands(), ["plugin", "list", "r1"]).stdout.splitlines()
    shown = [line.strip() for line in lines]
    assert shown[1].endswith("ValueError: a")
    assert shown[2] == "b"
    assert shown[-2:] == ["ValueError: a", "b"]
    assert "raise ValueError('a\\nb')" in shown, "the line of code is printed as it is written"
