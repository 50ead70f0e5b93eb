"""The two shells: `robrain shell ROBOT` over the wire, and the one at the robot's own terminal."""

import io
import sys

import pytest
from prompt_toolkit.application import create_app_session
from prompt_toolkit.completion import CompleteEvent
from prompt_toolkit.document import Document
from prompt_toolkit.input import create_pipe_input
from prompt_toolkit.output import DummyOutput

from robrain import Team
from robrain.agent.lifecycle.external_function import external_functions
from robrain.agent.plugin import Unit, external
from robrain.deploy.commands.shell import RemoteCommands, RobotCompleter, completions, history_path, run_shell
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.host_messages import HOST_COMMAND
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS, PluginInfo
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session

pytestmark = pytest.mark.system


class Driver(Unit):
    """Drives."""

    @external
    def drive(self, distance_m: float, speed_m_s: float = 0.5) -> bool:
        """Drive straight ahead."""
        return True

    @external
    def stop(self) -> None:
        """Stand still."""


def info(name, *, visible=True):
    functions = [info for function in external_functions(Driver).values() for info in function.infos]
    visibility = ["command"] if visible else []
    return PluginInfo(
        name=name, level="unit", state="active", visibility=visibility, doc="Drives.", functions=functions
    )


PLUGINS = [info("driver"), info("drill"), info("hidden", visible=False)]


@pytest.fixture(scope="module")
def team():
    """A client of a robot's team; the robot's host is played."""
    with open_session(mode="router", listen=["tcp/127.0.0.1:0"]) as session:
        robot = Endpoint(session, "default", LiveClock(), Drive.LIVE)
        robot.answer(ROBOT_PLUGINS, lambda request: PLUGINS, robot="r1")

        def command(request):
            text = request.asked.text
            if "stop" in text:
                return ""
            if "refuse" in text:
                raise CallError(ErrorCode.BUSY, "somebody else drives")
            return f"did {text}"

        robot.answer(HOST_COMMAND, command, robot="r1")
        with Team.connect(listening_at(session)[0]) as person:
            yield person
        robot.close()


def read(monkeypatch, team, data):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
    return run_shell(team, "r1", interactive=False)


def test_lines_of_stdin_are_executed_and_answered(team, monkeypatch, capsys):
    status = read(monkeypatch, team, b"call driver drive(1.0)\n\ncall driver stop()\nlist\n")
    assert status == 0
    assert capsys.readouterr().out == "did call driver drive(1.0)\ndriver drill\n"


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (b"call driver refuse()", "error busy: somebody else drives"),
        (b"fly", "error bad_arguments: expected `call PLUGIN FUNCTION(ARGUMENTS)`"),
        (b"help nobody", "error unknown_plugin: no plugin nobody"),
        (b"\xff", "error bad_arguments: "),
    ],
)
def test_a_line_that_fails_makes_the_exit_status_1_and_the_rest_goes_on(team, monkeypatch, capsys, line, answer):
    assert read(monkeypatch, team, line + b"\ncall driver drive(1.0)") == 1
    first, last = capsys.readouterr().out.splitlines()
    assert first.startswith(answer)
    assert last == "did call driver drive(1.0)"


def test_a_person_types_commands_which_are_remembered(team, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with create_pipe_input() as keys, create_app_session(input=keys, output=DummyOutput()):
        keys.send_text("call driver drive(2)\r\rfly\rexit\r")
        assert run_shell(team, "r1", interactive=True) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "r1: 2 plugins; `help` tells what can be called, `exit` or Ctrl-D ends"
    assert out[1] == "did call driver drive(2)"
    assert out[2].startswith("error bad_arguments: ")
    assert history_path() == tmp_path / "robrain" / "shell_history"
    assert "+call driver drive(2)" in history_path().read_text()


def test_completions_replace_what_was_begun_and_say_what_they_are(team):
    commands = RemoteCommands(team, "r1")
    commands.refresh()
    document = Document("call driver dr")
    (found,) = RobotCompleter(commands).get_completions(document, CompleteEvent())
    assert (found.text, found.start_position) == ("drive(", -2)
    assert found.display_meta_text == "drive(distance_m: float, speed_m_s: float = 0.5) -> bool"


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("", ["call ", "help ", "list", "exit"]),
        ("he", ["help "]),
        ("call ", ["driver ", "drill "]),
        ("call dri", ["driver ", "drill "]),
        ("call drill", ["drill "]),
        ("help drive", ["driver"]),
        ("call driver ", ["drive(", "stop("]),
        ("call driver s", ["stop("]),
        ("call driver drive(", ["distance_m=", "speed_m_s="]),
        ("call driver drive(1.0, s", ["speed_m_s="]),
        ("call driver drive(distance_m=1, ", ["speed_m_s="]),  # each once
        ("call driver bool.drive-double-double(", ["distance_m=", "speed_m_s="]),
        ("call driver stop(", []),
        ("call nobody ", []),
        ("call nobody drive(", []),
        ("nonsense ", []),
    ],
)
def test_what_may_come_next_is_offered(team, typed, offered):
    commands = RemoteCommands(team, "r1")
    commands.refresh()
    found = completions(typed, commands.plugins)
    assert [text for text, _, _ in found] == offered
    assert all(text.startswith(begun) and typed.endswith(begun) for text, begun, _ in found)
