"""`robrain call`: one call of a robot's plugin from a command line; `robrain log`: what its plugins print and log."""

import re
from collections.abc import Iterator

import pytest

from robrain import Team
from robrain.agent.host.command_door import parse_call
from robrain.agent.host.robot_log import RobotLog
from robrain.agent.lifecycle.external_function import external_functions
from robrain.agent.plugin import Unit, external
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots import plugin_messages
from robrain.protocol.messages.robots.action_messages import ActionEnd, ActionId, Outcome
from robrain.protocol.messages.robots.host_messages import HOST_COMMAND
from robrain.protocol.messages.robots.plugin_messages import PluginEvent, PluginInfo
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.wire.endpoint import Drive, Endpoint, Request
from robrain.protocol.wire.session import open_session
from tests.system.conftest import Commands

pytestmark = pytest.mark.system


LOGS: list[RobotLog] = []
"""The fake robot's."""


class Drawer(Unit):
    """Echoes its arguments."""

    pulled: ActionEnd | None = None

    @external
    def draw(self, x_m: float, label: str = "-") -> tuple[float, str]:
        return (x_m, label)

    @external
    def clear(self) -> None:
        return

    @external
    def pull(self, end: str) -> ActionId:
        self.pulled = ActionEnd(action=f"pull-{end}", outcome=Outcome(end), why=f"{end} by push", by="push")
        return self.pulled.action

    @external
    def fail(self) -> None:
        raise CallError(ErrorCode.FAILED, "it broke", "Traceback:\n  file.py, line 3")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Commands]:
    """A fake robot with a drawer at the commands' hub."""
    commands = Commands(tmp_path_factory.mktemp("team"))
    functions, drawer = external_functions(Drawer), Drawer.__new__(Drawer)
    with open_session(mode="router", listen=[commands.hub.endpoint]) as session:
        wire = Endpoint(session, "default", LiveClock(), Drive.LIVE)

        def command(request: Request) -> str:
            call = parse_call(request.asked.text)
            assert call.plugin == "drawer"
            return functions[call.function].call_text(drawer, call.arguments)

        def called(request: Request) -> object:
            return functions[request.names["function"]].call(drawer, request.asked)

        wire.token(ROBOT_ALIVE, robot="r1")
        wire.answer(HOST_COMMAND, command, robot="r1")

        def plugins(_request: Request) -> list[PluginInfo]:
            known = [info for function in functions.values() for info in function.infos]
            finished.put(PluginEvent(robot="r1", plugin="drawer", event="finished", value=drawer.pulled))
            return [PluginInfo(name="drawer", level="unit", state="active", functions=known)]

        finished = wire.publisher(plugin_messages.ROBOT_EVENT, robot="r1", plugin="drawer", event="finished")
        wire.answer(plugin_messages.ROBOT_PLUGINS, plugins, robot="r1")
        wire.answer(plugin_messages.ROBOT_CALL, called, robot="r1", plugin="drawer")
        LOGS.append(RobotLog(wire, "r1"))
        wire.answer(plugin_messages.ROBOT_LOG_KEPT, LOGS[0].kept, robot="r1")
        yield commands
        wire.close()
    commands.stop_all()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["draw", "1.5"], '[1.5, "-"]\n'),
        (["draw", "-1.5", "label=a b"], '[-1.5, "a b"]\n'),  # a negative number is not an option
        (["draw", "label=x", "x_m=2"], '[2.0, "x"]\n'),
        (["draw(1.5, x)"], '[1.5, "x"]\n'),  # as in the shell
        (["draw", '[1, "y"]'], '[1, "y"]\n'),
        (["draw", '{"x_m": 3, "label": "z"}'], '[3, "z"]\n'),
        (["clear"], ""),
        (["clear", "[]"], ""),
    ],
)
def test_arguments_are_text_or_json_and_the_result_is_text(robot: Commands, words: list[str], said: str) -> None:
    done = robot.run_here("call", "r1", "drawer", *words)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout in (said, said.replace("[1,", "[1.0,").replace("[3,", "[3.0,"))


@pytest.mark.parametrize(
    ("words", "status", "lines"),
    [
        (["pull", "superseded"], 1, ["pull-superseded", "superseded by push"]),
        (["pull(done)"], 0, ["pull-done", "done: done by push"]),
        (["pull", "failed", "--json"], 1, ['{"action":"pull-failed","outcome":"failed","why":"failed by push",']),
    ],
)
def test_call_waits_for_the_end_of_a_long_action(
    robot: Commands, words: list[str], status: int, lines: list[str]
) -> None:
    done = robot.run("call", "r1", "drawer", *words)
    assert (done.returncode, done.stderr) == (status, "")
    shown = done.stdout.splitlines()
    assert [line[: len(wanted)] for line, wanted in zip(shown, lines, strict=True)] == lines


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["r1", "drawer", "draw"], "missing argument `x_m`"),
        (["r1", "drawer", "draw", "1", "a, b"], "expected one argument per word; put text with commas or brackets in"),
        (["r1", "drawer", "draw", "[1"], "expected a JSON array or object"),
        (["r1", "drawer", "draw", "1", "label=a", "--json"], "expected either all arguments as NAME=VALUE, or none"),
        (["r1", "draw/er", "draw"], "bad plugin name 'draw/er'"),
        (["r1", "drawr"], "r1 has no plugin drawr; there are: drawer"),
        (["r2", "drawer", "draw"], "no robot r2 in team default; there are: r1"),
    ],
)
def test_an_invalid_call_is_one_sentence(robot: Commands, words: list[str], said: str) -> None:
    assert said in robot.refused("call", *words)


def test_what_a_plugin_says_of_its_failure_stands_below_it(robot: Commands) -> None:
    done = robot.run_here("call", "r1", "drawer", "fail", "{}")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "robrain: it broke\n  Traceback:\n    file.py, line 3\n"


def test_log_prints_the_last_lines_and_follows_further_ones(robot: Commands) -> None:
    LOGS[0].put("drawer", "info", "open")
    LOGS[0].put("halt", "warning", "halted by ann:\nstop")
    lines = [(r"drawer: open\n"), (r"halt warning: halted by ann:\n  stop\n")]
    for words, said in (((), lines), (("--plugin", "drawer"), lines[:1])):
        done = robot.run_here("log", "r1", *words)
        assert (done.returncode, done.stderr) == (0, "")
        assert re.fullmatch("".join(rf"\d\d:\d\d:\d\d {line}" for line in said), done.stdout)
    with Team.connect(robot.hub.endpoint) as team:
        records = team.log("r1", follow=True)
        assert [next(records).source for _ in lines] == ["drawer", "halt"]
        LOGS[0].put("drawer", "info", "shut")
        assert next(records).text == "shut"
    done = robot.run_here("log", "r1", "--plugin", "ghost")
    assert (done.returncode, done.stderr) == (2, "robrain: r1 has no plugin ghost; there are: drawer\n")
