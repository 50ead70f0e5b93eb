"""The standard streams and logs of a process."""

import json
import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from robrain import cli
from robrain.deploy.command_line.output import print_message, print_result
from robrain.deploy.processes.process_setup import FORMAT_VARIABLE, JsonLines, LogContext, guarded_streams, set_up_logs
from robrain.protocol.workers import OwnedThread

SENTENCES = {
    "full": "robrain: the output cannot be written: No space left on device\n",
    "closed": "robrain: the output cannot be written: it is closed\n",
    "pipe": "robrain: the output cannot be written: Broken pipe\n",
}


@contextmanager
def unwritable(how: str) -> Iterator[None]:
    kept, stdout, real = os.dup(1), sys.stdout, sys.__stdout__
    if how == "full":
        broken = os.open("/dev/full", os.O_WRONLY)
    else:
        reads, broken = os.pipe()
        os.close(reads)
    os.dup2(broken, 1)
    os.close(broken)
    if how == "closed":
        os.close(1)
        sys.__stdout__ = None  # type: ignore[misc] # as Python does at its start
    sys.stdout = sys.__stdout__
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        sys.stdout, sys.__stdout__ = stdout, real  # type: ignore[misc]


def ends(how: str, act: Callable[[], object]) -> None:
    with unwritable(how), pytest.raises(SystemExit) as ended:
        act()
    assert ended.value.code == 1


@pytest.mark.parametrize("how", SENTENCES)
def test_a_command_says_that_its_help_cannot_be_written(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    monkeypatch.setattr(cli, "set_up_logs", lambda words: words)  # leaves the logs of the tests alone
    monkeypatch.setattr("sys.argv", ["robrain", "run", "--help"])
    ends(how, cli.main)
    assert capsys.readouterr().err == SENTENCES[how]


def test_output_that_fails_in_another_thread_interrupts_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    def in_thread() -> None:
        thread = OwnedThread("thread", print_result, "hello")
        thread.close()

    def act() -> None:
        with guarded_streams():
            with pytest.raises(KeyboardInterrupt):
                in_thread()
            print_result("discarded")

    ends("pipe", act)
    assert capsys.readouterr().err == SENTENCES["pipe"]


def test_messages_that_cannot_be_written_do_not_end_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = os.dup(2)
    monkeypatch.setattr(sys, "stderr", sys.__stderr__)
    os.dup2(os.open("/dev/full", os.O_WRONLY), 2)
    try:
        with guarded_streams():
            print_message("a message")
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def test_folder_that_cannot_be_made_ends_a_command_with_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["robrain", "machine-files", "/dev/null/files"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert (ended.value.code, capsys.readouterr().err) == (
        2,
        "robrain: /dev/null/files cannot be used: Not a directory\n",
    )


def record(error=None):
    exc_info = (type(error), error, None) if error is not None else None
    return logging.LogRecord("robrain.x", logging.WARNING, "x.py", 1, "%s is late", ("r1",), exc_info)


def test_line_has_robot_plugin_and_task():
    context = LogContext()
    context.robot, context.plugin, context.task = "r1", lambda: "driver", lambda: "visit-1"
    line = JsonLines(context).format(record())
    assert "\n" not in line
    found = json.loads(line)
    assert (found["level"], found["logger"], found["message"]) == ("warning", "robrain.x", "r1 is late")
    assert (found["robot"], found["plugin"], found["task"]) == ("r1", "driver", "visit-1")
    assert found["time"].endswith("+00:00")


@pytest.fixture
def logs(monkeypatch):
    """The root logger as it was, after the test."""
    monkeypatch.setenv(FORMAT_VARIABLE, "")
    root = logging.getLogger()
    kept, level = root.handlers[:], root.level
    root.handlers = []
    yield root
    root.handlers, root.level = kept, level


@pytest.mark.parametrize(
    ("words", "rest", "is_json"),
    [
        (["--log-format", "json", "up"], ["up"], True),
        (["--log-format=json", "up", "x"], ["up", "x"], True),
        (["up", "--log-format"], ["up", "--log-format"], False),
        ([], [], False),
    ],
)
def test_format_is_chosen_before_the_command(logs, words, rest, is_json):
    assert set_up_logs(words) == rest
    (handler,) = logs.handlers
    assert isinstance(handler.formatter, JsonLines) is is_json
