"""Log records as JSON lines, with the robot, the plugin and the task that they are about."""

import json
import logging

import pytest

from robrain.deploy.errors import UsageError
from robrain.deploy.processes import process_setup
from robrain.deploy.processes.process_setup import FORMAT_VARIABLE, JsonLines, LogContext, set_up_logs


def record(error=None):
    exc_info = (type(error), error, None) if error is not None else None
    return logging.LogRecord("robrain.x", logging.WARNING, "x.py", 1, "%s is late", ("r1",), exc_info)


def test_line_has_robot_plugin_and_task():
    context = LogContext()
    context.robot, context.plugin, context.task = "r1", lambda: "driver", lambda: ("visit-1", "4bf92f35")
    line = JsonLines(context).format(record())
    assert "\n" not in line
    found = json.loads(line)
    assert (found["level"], found["logger"], found["message"]) == ("warning", "robrain.x", "r1 is late")
    assert (found["robot"], found["plugin"], found["task"]) == ("r1", "driver", "visit-1")
    assert found["trace"] == "4bf92f35"
    assert found["time"].endswith("+00:00")


def test_what_is_not_known_is_left_out_and_an_error_has_its_traceback():
    found = json.loads(JsonLines(LogContext()).format(record(ValueError("a\nb"))))
    assert not {"robot", "plugin", "task", "trace"} & set(found)
    assert found["traceback"].startswith("ValueError: a")


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


def test_environment_chooses_it_as_well_and_processes_inherit_it(logs, monkeypatch):
    monkeypatch.setenv(FORMAT_VARIABLE, "json")
    assert set_up_logs(["up"]) == ["up"]
    assert isinstance(logs.handlers[0].formatter, JsonLines)
    set_up_logs(["--log-format", "text", "up"])
    assert process_setup.os.environ[FORMAT_VARIABLE] == "text"


@pytest.mark.parametrize("words", [["--log-format", "xml"], ["--log-format"], ["--log-format="]])
def test_unknown_format_is_refused(logs, words):
    with pytest.raises(UsageError, match="expected text or json"):
        set_up_logs(words)
