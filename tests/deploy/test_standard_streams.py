"""Output that cannot be written ends a command with one sentence and an exit status."""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click
import pytest
import typer

from robrain import cli
from robrain.deploy.command_line.output import print_note, print_result
from robrain.deploy.processes.process_setup import guarded_streams

APP = typer.main.get_command(cli.all_commands())
SENTENCES = {
    "full": "robrain: the output cannot be written: No space left on device\n",
    "closed": "robrain: the output cannot be written: it is closed\n",
    "pipe": "robrain: the output cannot be written: Broken pipe\n",
}


def commands(group: click.Command, *words: str) -> Iterator[tuple[str, ...]]:
    yield words
    for name, each in getattr(group, "commands", {}).items():
        yield from commands(each, *words, name)


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


@pytest.mark.parametrize(
    ("words", "how"), [*((words, "full") for words in commands(APP)), (("run",), "closed"), (("run",), "pipe")]
)
def test_every_command_says_that_its_help_cannot_be_written(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], how: str
) -> None:
    monkeypatch.setattr(cli, "app", APP)  # is not built for each of them
    monkeypatch.setattr(cli, "set_up_logs", lambda words: words)  # leaves the logs of the tests alone
    monkeypatch.setattr("sys.argv", ["robrain", *words, "--help"])
    ends(how, cli.main)
    assert capsys.readouterr().err == SENTENCES[how]


def test_output_that_fails_in_another_thread_interrupts_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    def in_thread() -> None:
        thread = threading.Thread(target=print_result, args=("hello",))
        thread.start()
        thread.join()

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
            print_note("a message")
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
